"""Error against run time of the response of the specimen to a burst train, and of a stiff lumped model."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING, Literal

import numpy as np

from hpe_rig.arrays import FloatArray, Int64Array
from hpe_rig.validation.accuracy.work_precision import Point, measured

if TYPE_CHECKING:
    from sim_backend.settings import Specimen

WIDTH_M = (0.17e-3, 0.17e-3, 1.80e-3)
BURSTS, PERIOD_PS, BURST_PS = 20, 10_000_000_000, 100_000_000


def points() -> Iterator[Point]:
    """Yield points of the response to 20 bursts at 800 times in each medium, then of the lumped model."""
    from sim_backend.settings import Specimen

    for case, medium in {
        "gelatin 8 %": {"preset": "gelatin_8"},
        "bovine muscle": {"preset": "bovine_muscle"},
        "elastic 7.25 kPa": {"shear_viscosity_pa_s": 0.0},
        "Voigt 1 Pa, 100 Pa s": {"shear_modulus_pa": 1.0, "shear_viscosity_pa_s": 100.0},
        "power law 0.3": {"medium": "power_law", "power": 0.3},
        "Maxwell 10 kPa, 1 mPa s": {"medium": "maxwell", "shear_modulus_pa": 1e4, "shear_viscosity_pa_s": 1e-3},
        "Zener 1 kPa, 10 MPa": {"medium": "zener", "shear_modulus_pa": 1e3, "branch_modulus_pa": 1e7},
    }.items():
        yield from _transient_points(case, Specimen.model_validate(medium))
    yield from _lumped_points()


def _transient_points(case: str, specimen: Specimen) -> Iterator[Point]:
    from sim_backend.motion import (
        Contour,
        ForcePulses,
        Panels,
        StepResponse,
        panels_of,
        settling_time_s,
        transfer,
        transient_displacement,
    )

    onset_ps = np.arange(BURSTS) * PERIOD_PS
    force = ForcePulses(onset_ps, onset_ps + BURST_PS, np.ones(BURSTS))
    time_ps = 175_000_000 + np.arange(800) * 250_000_000

    def by_panels(contour: Contour, degrees: int) -> FloatArray:
        panels: Panels = panels_of(lambda s: transfer(specimen, WIDTH_M, s)[:, None], contour, degrees)
        return transient_displacement(StepResponse(settling_time_s(specimen, panels), panels), force, time_ps)

    # Reference: more than twice the nodes and degrees of the default setting.
    exact = by_panels(Contour(72, 5.2, 1.5, 0.5), 48)
    for nodes, degrees in ((6, 6), (10, 10), (16, 14), (24, 20), (32, 24)):
        # Optimal contours are shorter and lower for fewer nodes.
        contour = Contour(nodes, 3.5 * (nodes / 32) ** 0.3, 3.0 * nodes / 32, 0.65)
        setting = f"{nodes} nodes, {degrees} degrees"
        yield measured(case, "hyperbola, panels of log time", setting, partial(by_panels, contour, degrees), exact)
    for period_s, highest_hz in ((0.25, 2e3), (0.25, 2e4), (1.0, 1e4)):
        setting = f"{period_s:g} s, {highest_hz / 1e3:g} kHz"
        compute = partial(_fourier, specimen, time_ps, period_s, highest_hz)
        yield measured(case, "Fourier synthesis, padded", setting, compute, exact, repeats=1)


def _fourier(specimen: Specimen, time_ps: Int64Array, period_s: float, highest_hz: float) -> FloatArray:
    """Return the response to the train, repeated with ``period_s``, from its Fourier series up to ``highest_hz``."""
    from sim_backend.motion import frequency_response

    frequency_hz = np.arange(1, int(highest_hz * period_s) + 1) / period_s
    # Fourier transform of one rectangular burst, then the sum over the burst onsets.
    burst_s = BURST_PS * 1e-12
    burst = burst_s * np.sinc(frequency_hz * burst_s) * np.exp(-1j * np.pi * frequency_hz * burst_s)
    train = burst * np.exp(-2j * np.pi * np.outer(np.arange(BURSTS) * PERIOD_PS * 1e-12, frequency_hz)).sum(axis=0)
    coefficient = 2 / period_s * train * frequency_response(specimen, WIDTH_M, frequency_hz)
    # The series has no mean: the medium is at rest at time 0, which fixes it.
    time_s = np.append(time_ps * 1e-12, 0.0)
    value = np.array([(coefficient * np.exp(2j * np.pi * frequency_hz * t)).sum().real for t in time_s])
    return np.asarray(value[:-1] - value[-1])


def _lumped_points() -> Iterator[Point]:
    """Yield points of thirteen spring-dashpot pairs under a unit step: time constants 1e-9 to 1e3 s, 60 times."""
    from scipy.integrate import DOP853, solve_ivp

    from sim_backend.motion import AXIS_CONTOUR, panels_of

    constants_s = np.logspace(-9, 3, 13)
    time_s = np.logspace(-10, 3, 60)
    exact = -np.expm1(-time_s[:, None] / constants_s)
    case = "lumped, 1e-9 to 1e3 s"

    def panels_solution() -> FloatArray:
        return panels_of(lambda s: 1 / (1 + s[:, None] * constants_s), AXIS_CONTOUR).at(time_s)

    yield measured(case, "hyperbola, panels of log time", "32 nodes, 24 degrees", panels_solution, exact)

    def slope(_t: float, y: FloatArray) -> FloatArray:
        return (1 - y) / constants_s

    def implicit_solution(method: Literal["Radau", "BDF"], tolerance: float) -> FloatArray:
        start = np.zeros(constants_s.size)
        solution = solve_ivp(slope, (0, 1e3), start, method, time_s, rtol=tolerance, atol=tolerance * 1e-3)
        return np.asarray(solution.y.T)

    def explicit_solution(evaluations: int) -> FloatArray:
        """Stop an explicit solver, which is stable only for steps of a few ns, after a number of evaluations."""
        solver = DOP853(slope, 0, np.zeros(constants_s.size), 1e3, rtol=1e-4, atol=1e-7)
        value = np.zeros(exact.shape)
        while solver.nfev < evaluations:
            solver.step()
            value[time_s > (solver.t_old or 0.0)] = solver.y
        return value

    implicit: tuple[Literal["Radau"], Literal["BDF"]] = ("Radau", "BDF")
    for method in implicit:
        for tolerance in (1e-4, 1e-7):
            setting = f"rtol {tolerance:g}"
            yield measured(case, f"scipy {method}", setting, partial(implicit_solution, method, tolerance), exact, 1)
    for evaluations in (2_000, 20_000, 100_000):
        setting = f"{evaluations} evaluations"
        yield measured(case, "DOP853 (explicit)", setting, partial(explicit_solution, evaluations), exact, 1)
