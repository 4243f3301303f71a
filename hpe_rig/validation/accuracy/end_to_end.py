"""Error of the final amplitude against run time, end to end: tonebursts, medium, echoes, noise, estimate.

Scene: bovine muscle, 15 tonebursts at 100 Hz, pulses at 3990 Hz, the last 100 ms used, noise 40 dB below the echo. The
final amplitude is the estimate at 200 Hz divided by the beam-averaging factor, and averaged over realisations of
scatterers and noise. The true amplitude is the steady state in closed form. The pulse rate is not 4000 Hz, because
every burst period would then be sampled at the same phases and harmonics near 3.8 kHz would alias onto 200 Hz (9 %).
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from hpe_rig.arrays import FloatArray
from hpe_rig.medium import TrackingGate, beam_averaging_factor, scatterer_density
from hpe_rig.prediction import force_spectrum
from hpe_rig.processing import ESTIMATORS, EchoGate, estimate, margin_samples, spec_of
from hpe_rig.result import label_decades, legend, mark
from hpe_rig.scene import Estimator
from hpe_rig.validation.accuracy.work_precision import grouped, pareto, save_figure, timed

if TYPE_CHECKING:
    from sim_backend.settings import SimulationSettings


FREQUENCY_HZ, BURST_RATE_HZ, BURST_LENGTH_S, BURSTS = 200.0, 100.0, 100e-6, 15
PULSE_RATE_HZ, FIRST_PULSE_S, WINDOW_START_S = 3990.0, 130e-6, 50e-3
FORCE_N_PER_M3, SNR_DB = 5.0e6, 40.0
CARRIER_HZ, SAMPLE_RATE_HZ = 9e6, 100e6
NUMERICAL_DRAWS = 16
"""Draws of scatterers for the numerical error."""
EXACT_TOLERANCE = 1e-12
MAX_REPEATED = 10
"""Up to this number of realisations the minimum of three run times is reported."""
MARGIN = margin_samples(SAMPLE_RATE_HZ, CARRIER_HZ)
"""Samples on each side of the gate, as in a record."""


@dataclass(frozen=True, slots=True)
class Variant:
    """Settings of simulation and estimation; the defaults are those of the program."""

    estimator: Estimator = "coherent"
    gate_length_m: float = 1e-3
    tolerance: float = 1e-6
    """Relative error allowed in the echoes."""
    nodes: int = 32
    """Nodes of the contour of the inverse Laplace transform."""
    degrees: int = 24
    """Polynomial degrees of the panels in log time."""


@dataclass(frozen=True, slots=True)
class EndToEnd:
    """Errors of one variant and number of realisations, relative to the true amplitude."""

    varied: str
    estimator: str
    gate_length_m: float
    tolerance: float
    nodes: int
    degrees: int
    realisations: int
    numerical_error: float
    """Root mean square error due to tolerance and nodes, on noise-free draws."""
    bias: float
    """Bias of the mean over the largest number of realisations; its standard error is ``bias_uncertainty``."""
    bias_uncertainty: float
    standard_error: float
    """Standard deviation of the mean over ``realisations``, due to scatterers and noise."""
    error: float
    """Bias and standard error combined."""
    time_s: float
    """Processor time of all realisations, medium and estimation included, s."""
    shipped: bool
    """Whether all settings are the defaults of the program."""
    on_front: bool
    """Whether the row is on the Pareto front of time and error."""
    cores: int


def variants() -> list[tuple[str, Variant]]:
    """Return (name of the varied setting, variant): every estimator in every gate, then tolerance and nodes."""
    shipped = Variant()
    varied = [
        ("estimator and gate", replace(shipped, estimator=name, gate_length_m=gate_m))
        for gate_m in (0.5e-3, 1e-3, 2e-3)
        for name in ESTIMATORS
    ]
    varied += [("tolerance", replace(shipped, tolerance=tolerance)) for tolerance in (1e-1, 1e-2, 1e-4, 1e-8, 1e-10)]
    nodes = ((6, 6), (10, 10), (16, 14), (24, 20))
    return varied + [("nodes", replace(shipped, nodes=n, degrees=degrees)) for n, degrees in nodes]


def rows(
    realisations: Sequence[int] = (1, 10, 100, 1000),
    tried: Iterable[tuple[str, Variant]] | None = None,
    seed: int = 0,
) -> list[EndToEnd]:
    """Return a row for every variant and number of realisations (ascending; the largest gives the bias)."""
    computed = [row for varied, variant in tried or variants() for row in _rows_of(varied, variant, realisations, seed)]
    front = set(pareto([row.time_s for row in computed], [row.error for row in computed]))
    return [replace(row, on_front=index in front) for index, row in enumerate(computed)]


def amplitudes(variant: Variant, realisations: int, seed: int) -> FloatArray:
    """Return the final amplitude of each realisation, m, (realisation,)."""
    from sim_backend.echoes import drawn_echoes, hann_pulse

    settings = scene()
    # The motion is the same in every realisation; scatterer positions and noise differ.
    displacement_m = displacement(variant.nodes, variant.degrees)
    pulse = hann_pulse(CARRIER_HZ, settings.scatterers.bandwidth)
    scatterers, noise = (np.random.default_rng([seed, stream]) for stream in (0, 1))
    amplitude_m = []
    for clean in drawn_echoes(
        settings, displacement_m, pulse, _gate_s(variant), scatterers, realisations, variant.tolerance
    ):
        # The noise of each realisation is SNR_DB below its echoes.
        noise_v = np.sqrt(np.mean(clean[..., MARGIN:-MARGIN] ** 2, axis=(-2, -1), keepdims=True) / 10 ** (SNR_DB / 10))
        amplitude_m.append(_estimate(variant, clean + noise_v * noise.standard_normal(clean.shape)))
    return np.concatenate(amplitude_m)


def numerical_error(variant: Variant, seed: int = 0) -> float:
    """Return the relative rms change of noise-free amplitudes due to tolerance and nodes."""
    # Both use the same scatterers and no noise, so that only the numerical error remains.
    rough = _noise_free_amplitudes(variant, variant.tolerance, displacement(variant.nodes, variant.degrees), seed)
    fine = _noise_free_amplitudes(variant, EXACT_TOLERANCE, displacement(72, 48), seed)
    return float(np.sqrt(np.mean((rough / fine - 1) ** 2)))


def true_amplitude_m() -> float:
    """Return the steady amplitude at 200 Hz, m: Fourier coefficient of the force times response of the medium."""
    from sim_backend.motion import frequency_response

    settings = scene()
    assert settings.specimen is not None  # noqa: S101
    width_m, frequency_hz = settings.beams.excitation_width_m, np.array([FREQUENCY_HZ])
    response = frequency_response(settings.specimen, width_m, frequency_hz)[0]
    # The line at 200 Hz and its conjugate each hold half of the amplitude.
    force = force_spectrum(round(FREQUENCY_HZ / BURST_RATE_HZ), BURST_RATE_HZ, BURST_LENGTH_S, FORCE_N_PER_M3)
    return float(2 * np.abs(force * response))


def scene() -> SimulationSettings:
    """Return the settings of the twin."""
    from sim_backend.settings import SimulationSettings, Specimen

    return SimulationSettings(specimen=Specimen(preset="bovine_muscle", field="gaussian"))


def displacement(nodes: int, degrees: int) -> FloatArray:
    """Return the displacement at the focus at the time of each pulse in the window, m, (pulse,)."""
    from sim_backend.motion import (
        Contour,
        ForcePulses,
        StepResponse,
        panels_of,
        settling_time_s,
        transfer,
        transient_displacement,
    )
    from sim_backend.wiring import to_ps

    settings = scene()
    assert settings.specimen is not None  # noqa: S101
    specimen, width_m = settings.specimen, settings.beams.excitation_width_m
    # The default contour has 32 nodes. The optimal contour is shorter and lower for fewer nodes, longer for more.
    ratio = nodes / 32
    contour = Contour(nodes, 3.5 * ratio**0.3, 3.0 * ratio, 0.65) if ratio <= 1 else Contour(nodes, 5.2, 1.5, 0.5)
    panels = panels_of(lambda s: transfer(specimen, width_m, s)[:, None], contour, degrees)
    onset_ps = np.arange(BURSTS) * to_ps(1 / BURST_RATE_HZ)
    # Rectangular force pulses at the onset of each burst.
    force = ForcePulses(onset_ps, onset_ps + to_ps(BURST_LENGTH_S), np.full(BURSTS, FORCE_N_PER_M3))
    pulse_ps = np.round((_pulse_s() + FIRST_PULSE_S) * 1e12).astype(np.int64)
    return transient_displacement(StepResponse(settling_time_s(specimen, panels), panels), force, pulse_ps)


def _rows_of(varied: str, variant: Variant, realisations: Sequence[int], seed: int) -> Iterator[EndToEnd]:
    # An untimed run first: it imports, compiles and fills caches.
    amplitude_m = amplitudes(variant, realisations[0], seed)
    times_s = []
    for count in realisations:
        run = partial(amplitudes, variant, count, seed)
        runs = [timed(run, time.process_time) for _ in range(3 if count <= MAX_REPEATED else 1)]
        amplitude_m, _ = runs[-1]
        times_s.append(min(time_s for _, time_s in runs))
    # Bias and deviation come from the largest number of realisations, the last.
    truth_m = true_amplitude_m()
    bias, deviation = float(amplitude_m.mean() / truth_m - 1), float(amplitude_m.std(ddof=1) / truth_m)
    numerical = numerical_error(variant)
    for count, time_s in zip(realisations, times_s, strict=True):
        standard_error = deviation / math.sqrt(count)
        yield EndToEnd(
            varied=varied,
            **asdict(variant),
            realisations=count,
            numerical_error=numerical,
            bias=bias,
            bias_uncertainty=deviation / math.sqrt(len(amplitude_m)),
            standard_error=standard_error,
            error=math.hypot(bias, standard_error),
            time_s=time_s,
            shipped=variant == Variant(),
            on_front=False,
            cores=os.cpu_count() or 1,
        )


def _estimate(variant: Variant, volts: FloatArray) -> FloatArray:
    """Return amplitudes corrected for beam averaging, m, (realisation,), from echoes (realisation, pulse, sample)."""
    time_s = _pulse_s()
    valid = np.ones(len(time_s), dtype=bool)
    settings = scene()
    gate = EchoGate(volts, SAMPLE_RATE_HZ, time_s, CARRIER_HZ, settings.sound_speed_m_per_s, valid, (MARGIN, MARGIN))
    # The tonebursts drive every multiple of the burst rate; the first ten are fitted together.
    driven_hz = [n * BURST_RATE_HZ for n in range(1, 11) if n * BURST_RATE_HZ != FREQUENCY_HZ]
    fit = estimate(gate, [FREQUENCY_HZ], variant.estimator, driven_hz)
    return np.asarray(fit.amplitude_m[:, 0] / _averaging_factor(variant))


def _averaging_factor(variant: Variant) -> float:
    settings = scene()
    beams, scatterers = settings.beams, settings.scatterers
    # The pulse length in depth is half the speed of sound over the bandwidth.
    gate = TrackingGate(
        beams.tracking_width_m,
        variant.gate_length_m,
        settings.sound_speed_m_per_s / 2 / (scatterers.bandwidth * CARRIER_HZ),
        hann_window=spec_of(variant.estimator).gate_window == "hann",
    )
    density = scatterer_density(beams.tracking_width_m, scatterers.per_cell)
    return beam_averaging_factor(beams.excitation_width_m, gate, density)


def _noise_free_amplitudes(variant: Variant, tolerance: float, displacement_m: FloatArray, seed: int) -> FloatArray:
    from sim_backend.echoes import ScattererRows, batch, draw_thinned, hann_pulse

    settings, gate_s = scene(), _gate_s(variant)
    pulse = hann_pulse(CARRIER_HZ, settings.scatterers.bandwidth)
    # Scatterers with no echo in the gate at any tolerance compared here are not drawn.
    reach_s = (float(gate_s[0]) - 2 * pulse.end_s, float(gate_s[-1]) + 2 * pulse.end_s)
    field = draw_thinned(settings, reach_s, EXACT_TOLERANCE, np.random.default_rng(seed), NUMERICAL_DRAWS)
    amplitude_s = np.broadcast_to(
        displacement_m[:, None] * (2 / settings.sound_speed_m_per_s), (NUMERICAL_DRAWS, len(displacement_m), 1)
    )
    scatterers = ScattererRows(field.row, field.delay_s, field.tracking_weight, field.motion_weight[None], amplitude_s)
    return _estimate(variant, np.asarray(batch(scatterers, pulse, gate_s, tolerance), dtype=np.float64))


def _pulse_s() -> FloatArray:
    # The window ends at the last burst period.
    count = round((BURSTS / BURST_RATE_HZ - WINDOW_START_S) * PULSE_RATE_HZ)
    return np.asarray(WINDOW_START_S + np.arange(count) / PULSE_RATE_HZ)


def _gate_s(variant: Variant) -> FloatArray:
    samples = round(2 * variant.gate_length_m / scene().sound_speed_m_per_s * SAMPLE_RATE_HZ) + 2 * MARGIN
    return np.asarray((np.arange(samples) - (samples - 1) / 2) / SAMPLE_RATE_HZ)


def draw_end_to_end(rows: Sequence[EndToEnd], path: Path) -> None:
    """Draw the error of every variant over run time, with the Pareto front and the default settings marked."""
    figure = Figure(figsize=(8, 4.8), layout="constrained")
    axes = figure.subplots()
    for index, (name, estimator_rows) in enumerate(grouped(rows, lambda row: row.estimator).items()):
        marker, colour = mark(index)
        size = [14 * (row.gate_length_m / 0.5e-3) for row in estimator_rows]
        axes.scatter(
            [row.time_s for row in estimator_rows], [row.error for row in estimator_rows], size,
            marker=marker, color=colour, alpha=0.7, label=name, linewidths=0.8,
        )  # fmt: skip
    # The front is a step function of time.
    front = sorted((row.time_s, row.error) for row in rows if row.on_front)
    axes.step(*zip(*front, strict=True), where="post", color="k", lw=1.2, label="Pareto front")
    shipped = [row for row in rows if row.shipped]
    points = [row.time_s for row in shipped], [row.error for row in shipped]
    axes.plot(*points, "*", label="default settings", ms=15, mfc="none", mec="k", mew=1.3, zorder=5)
    for row in shipped:
        count = f"{row.realisations} realisation{'s' if row.realisations > 1 else ''}"
        axes.annotate(count, (row.time_s, row.error), (6, 8), textcoords="offset points", fontsize=7)
    axes.set(xscale="log", yscale="log", xlabel="processor time, scene to amplitude (s)")
    axes.set_ylabel("rms error / true amplitude")
    label_decades(axes.xaxis)
    label_decades(axes.yaxis)
    axes.grid(alpha=0.3)
    legend(axes, "above", 4)
    save_figure(figure, path)
