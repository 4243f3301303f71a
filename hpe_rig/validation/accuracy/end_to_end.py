"""End-to-end error of the final amplitude against seconds: tonebursts, medium, echoes, noise, one number.

Scene: bovine muscle, 15 tonebursts at 100 Hz, pulses at 3990 Hz, the last 100 ms used, noise 40 dB below the echo. The
final amplitude is the mean over realisations (new scatterers, new noise) of the estimate at 200 Hz over the beams'
averaging factor; the truth is the steady state in closed form, so nothing that is tabulated, drawn or fitted enters it.
(At 4000 Hz every burst period is sampled at the same instants and harmonics near 3.8 kHz alias onto 200 Hz: 9 %.)
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hpe_rig.arrays import FloatArray
from hpe_rig.prediction import beam_averaging_factor, force_spectrum, scatterer_density
from hpe_rig.processing import ESTIMATORS, EchoGate, Estimator, estimate, margin_samples, spec_of
from hpe_rig.result import MARKS, label_decades, mark
from hpe_rig.validation.accuracy.work_precision import pareto

if TYPE_CHECKING:
    from sim_backend.settings import SimulationSettings


FREQUENCY_HZ, BURST_RATE_HZ, BURST_LENGTH_S, BURSTS = 200.0, 100.0, 100e-6, 15
PULSE_RATE_HZ, FIRST_PULSE_S, USED_FROM_S = 3990.0, 130e-6, 50e-3
FORCE_N_PER_M3, SNR_DB = 5.0e6, 40.0
CARRIER_HZ, SAMPLE_RATE_HZ = 9e6, 100e6
SAME_DRAWS = 16
EXACT_TOLERANCE = 1e-12
TIMED_AGAIN = 10
"""Realisations up to which the best of three runs is timed."""
ALIKE = 0.1
"""Times that differ by less than this share are taken for the same: the best of three repeats to about that."""
MARGIN = margin_samples(SAMPLE_RATE_HZ, CARRIER_HZ)
"""Samples before and behind the gate, as a record has them."""


@dataclass(frozen=True, slots=True)
class Way:
    """One way from the scene to the amplitude; the defaults are the shipped ones."""

    estimator: Estimator = "coherent"
    gate_length_m: float = 1e-3
    tolerance: float = 1e-6
    """Of the echoes."""
    nodes: int = 32
    """Of the medium's contour."""
    degrees: int = 24
    """Of its panels of log time."""


@dataclass(frozen=True, slots=True)
class EndToEnd:
    """One way and number of realisations; errors relative to the true amplitude."""

    varied: str
    estimator: str
    gate_length_m: float
    tolerance: float
    nodes: int
    degrees: int
    realisations: int
    numerical_error: float
    """What tolerance and nodes do to the amplitudes of the same noise-free draws, root mean square."""
    bias: float
    """Of the mean of the most realisations: what more of them do not mend, known to ``bias_uncertainty``."""
    bias_uncertainty: float
    standard_error: float
    """Standard deviation of the mean of ``realisations``, from scatterers and noise."""
    error: float
    """Root mean square of both."""
    time_s: float
    """Processor time of all realisations, medium and estimation included; up to ten of them: the best of three."""
    shipped: bool
    """Whether all is as shipped, apart from the realisations."""
    on_front: bool
    """Whether no other row is as good in less time."""
    cores: int


def ways() -> list[tuple[str, Way]]:
    """Return what is varied, and how: every estimator in every gate, then tolerance and nodes one at a time."""
    shipped = Way()
    found = [
        ("estimator and gate", replace(shipped, estimator=name, gate_length_m=gate_m))
        for gate_m in (0.5e-3, 1e-3, 2e-3)
        for name in ESTIMATORS
    ]
    found += [("tolerance", replace(shipped, tolerance=tolerance)) for tolerance in (1e-1, 1e-2, 1e-4, 1e-8, 1e-10)]
    nodes = ((6, 6), (10, 10), (16, 14), (24, 20))
    return found + [("nodes", replace(shipped, nodes=n, degrees=degrees)) for n, degrees in nodes]


def rows(
    realisations: Sequence[int] = (1, 10, 100, 1000),
    chosen: Iterable[tuple[str, Way]] | None = None,
    seed: int = 0,
) -> list[EndToEnd]:
    """Return a row for every way and number of realisations, ascending; the largest gives bias and deviation."""
    found = [row for varied, way in chosen or ways() for row in _of_way(varied, way, realisations, seed)]
    front = set(pareto([row.time_s for row in found], [row.error for row in found]))
    return [replace(row, on_front=index in front) for index, row in enumerate(found)]


def beating(found: Sequence[EndToEnd]) -> list[tuple[EndToEnd, float]]:
    """Return which ways are as right as the shipped one, within chance, in less time, and in what share of it.

    Errors are those of the most realisations n: a standard deviation is known to one part in the root of 2 n. Times are
    those of the most that are timed more than once.
    """
    counts = {row.realisations for row in found}
    most, repeated = max(counts), max((each for each in counts if each <= TIMED_AGAIN), default=min(counts))
    time_s = {_settings(row): row.time_s for row in found if row.realisations == repeated}
    last = [row for row in found if row.realisations == most]
    shipped = next(row for row in last if row.shipped)
    right = shipped.error * (1 + 1 / math.sqrt(2 * most))
    shares = [(row, time_s[_settings(row)] / time_s[_settings(shipped)]) for row in last if row.error <= right]
    return [(row, share) for row, share in shares if share < 1 - ALIKE]


def _settings(row: EndToEnd) -> tuple[str, float, float, int, int]:
    return row.estimator, row.gate_length_m, row.tolerance, row.nodes, row.degrees


def amplitudes(way: Way, realisations: int, seed: int) -> FloatArray:
    """Return the final amplitude of each realisation, m, (realisation,)."""
    from sim_backend.echoes import drawn_echoes, hann_pulse

    settings = scene()
    # The medium moves alike in every realisation: what differs is where its scatterers lie, and the noise.
    moved_m = displacement(way.nodes, way.degrees)
    pulse = hann_pulse(CARRIER_HZ, settings.scatterers.bandwidth)
    scatterers, noise = (np.random.default_rng([seed, stream]) for stream in (0, 1))
    found = []
    for clean in drawn_echoes(settings, moved_m, pulse, _gate_s(way), scatterers, realisations, way.tolerance):
        # Rms of the noise of each realisation, `SNR_DB` below its own echoes.
        noise_v = np.sqrt(np.mean(clean[..., MARGIN:-MARGIN] ** 2, axis=(-2, -1), keepdims=True) / 10 ** (SNR_DB / 10))
        found.append(_estimated(way, clean + noise_v * noise.standard_normal(clean.shape)))
    return np.concatenate(found)


def numerical_error(way: Way, seed: int = 0) -> float:
    """Return how far tolerance and nodes move noise-free amplitudes of the same scatterers, relative, rms."""
    # The same scatterers and no noise on both sides: what is left between them is the numerical error alone.
    rough = _of_same_draws(way, way.tolerance, displacement(way.nodes, way.degrees), seed)
    fine = _of_same_draws(way, EXACT_TOLERANCE, displacement(72, 48), seed)
    return float(np.sqrt(np.mean((rough / fine - 1) ** 2)))


def true_amplitude_m() -> float:
    """Return the steady amplitude at 200 Hz, the force's Fourier coefficient times the medium's response."""
    from sim_backend.motion import frequency_response

    settings = scene()
    assert settings.specimen is not None  # noqa: S101
    width_m, frequency_hz = settings.beams.excitation_width_m, np.array([FREQUENCY_HZ])
    response = frequency_response(settings.specimen, width_m, frequency_hz)[0]
    # Complex Fourier coefficient of the force's line at 200 Hz; its conjugate has the other half of the amplitude.
    force = force_spectrum(round(FREQUENCY_HZ / BURST_RATE_HZ), BURST_RATE_HZ, BURST_LENGTH_S, FORCE_N_PER_M3)
    return float(2 * np.abs(force * response))


def scene() -> SimulationSettings:
    """Return the scene in the twin's words."""
    from sim_backend.settings import SimulationSettings, Specimen

    return SimulationSettings(specimen=Specimen(preset="bovine_muscle", field="gaussian"))


def displacement(nodes: int, degrees: int) -> FloatArray:
    """Return the displacement at the focus when each used pulse senses it, m, (pulse,)."""
    from sim_backend.motion import (
        Contour,
        ForcePulses,
        StepResponse,
        memory_s,
        panels_of,
        transfer,
        transient_displacement,
    )
    from sim_backend.wiring import to_ps

    settings = scene()
    assert settings.specimen is not None  # noqa: S101
    specimen, width_m = settings.specimen, settings.beams.excitation_width_m
    # The shipped contour at 32 nodes; fewer need a shorter and lower one to be at their best, more a longer.
    share = nodes / 32
    contour = Contour(nodes, 3.5 * share**0.3, 3.0 * share, 0.65) if share <= 1 else Contour(nodes, 5.2, 1.5, 0.5)
    panels = panels_of(lambda s: transfer(specimen, width_m, s)[:, None], contour, degrees)
    onset_ps = np.arange(BURSTS) * to_ps(1 / BURST_RATE_HZ)
    force = ForcePulses(onset_ps, onset_ps + to_ps(BURST_LENGTH_S), np.full(BURSTS, FORCE_N_PER_M3))
    pulse_ps = np.round((_pulse_s() + FIRST_PULSE_S) * 1e12).astype(np.int64)
    return transient_displacement(StepResponse(memory_s(specimen, panels), panels), force, pulse_ps)


def _of_way(varied: str, way: Way, realisations: Sequence[int], seed: int) -> Iterator[EndToEnd]:
    # Once unmeasured: what is compiled, imported or kept is so by the first run.
    found = amplitudes(way, realisations[0], seed)
    times_s = []
    for count in realisations:
        taken_s = []
        for _ in range(3 if count <= TIMED_AGAIN else 1):
            start_s = time.process_time()
            found = amplitudes(way, count, seed)
            taken_s.append(time.process_time() - start_s)
        times_s.append(min(taken_s))
    # The last and largest number of realisations tells bias and spread; the smaller ones differ in time and by root n.
    truth_m = true_amplitude_m()
    bias, deviation = float(found.mean() / truth_m - 1), float(found.std(ddof=1) / truth_m)
    numerical = numerical_error(way)
    for count, time_s in zip(realisations, times_s, strict=True):
        standard_error = deviation / math.sqrt(count)
        yield EndToEnd(
            varied=varied,
            **asdict(way),
            realisations=count,
            numerical_error=numerical,
            bias=bias,
            bias_uncertainty=deviation / math.sqrt(len(found)),
            standard_error=standard_error,
            error=math.hypot(bias, standard_error),
            time_s=time_s,
            shipped=way == Way(),
            on_front=False,
            cores=os.cpu_count() or 1,
        )


def _estimated(way: Way, volts: FloatArray) -> FloatArray:
    """Return amplitudes over the beams' averaging, m, (realisation,) of echoes (realisation, pulse, sample)."""
    time_s = _pulse_s()
    valid = np.ones(len(time_s), dtype=bool)
    settings = scene()
    gate = EchoGate(volts, SAMPLE_RATE_HZ, time_s, CARRIER_HZ, settings.sound_speed_m_per_s, valid, (MARGIN, MARGIN))
    # The tonebursts drive every multiple of their rate: the first ten are fitted together.
    also_hz = [n * BURST_RATE_HZ for n in range(1, 11) if n * BURST_RATE_HZ != FREQUENCY_HZ]
    fit = estimate(gate, [FREQUENCY_HZ], way.estimator, also_hz)
    return np.asarray(fit.amplitude_m[:, 0] / _averaging(way))


def _averaging(way: Way) -> float:
    settings = scene()
    beams, scatterers = settings.beams, settings.scatterers
    return beam_averaging_factor(
        beams.excitation_width_m,
        beams.tracking_width_m,
        way.gate_length_m,
        settings.sound_speed_m_per_s / 2 / (scatterers.bandwidth * CARRIER_HZ),
        gate_window=spec_of(way.estimator).gate_window,
        scatterers_per_m3=scatterer_density(beams.tracking_width_m, scatterers.per_cell),
    )


def _of_same_draws(way: Way, tolerance: float, moved_m: FloatArray, seed: int) -> FloatArray:
    from sim_backend.echoes import ScattererRows, batch, draw_thinned, hann_pulse

    settings, gate_s = scene(), _gate_s(way)
    pulse = hann_pulse(CARRIER_HZ, settings.scatterers.bandwidth)
    # Scatterers whose echoes cannot reach the gate, at any tolerance compared here, are not drawn at all.
    reach_s = (float(gate_s[0]) - 2 * pulse.end_s, float(gate_s[-1]) + 2 * pulse.end_s)
    field = draw_thinned(settings, reach_s, EXACT_TOLERANCE, np.random.default_rng(seed), SAME_DRAWS)
    amplitude_s = np.broadcast_to(moved_m[:, None] * (2 / settings.sound_speed_m_per_s), (SAME_DRAWS, len(moved_m), 1))
    resting = ScattererRows(field.row, field.delay_s, field.tracking_weight, field.motion_weight[None], amplitude_s)
    return _estimated(way, np.asarray(batch(resting, pulse, gate_s, tolerance), dtype=np.float64))


def _pulse_s() -> FloatArray:
    count = round((BURSTS / BURST_RATE_HZ - USED_FROM_S) * PULSE_RATE_HZ)
    return np.asarray(USED_FROM_S + np.arange(count) / PULSE_RATE_HZ)


def _gate_s(way: Way) -> FloatArray:
    samples = round(2 * way.gate_length_m / scene().sound_speed_m_per_s * SAMPLE_RATE_HZ) + 2 * MARGIN
    return np.asarray((np.arange(samples) - (samples - 1) / 2) / SAMPLE_RATE_HZ)


def draw_end_to_end(rows: Sequence[EndToEnd], path: Path) -> None:
    """Draw error over run time of every way, and the numerical part of it over tolerance and nodes."""
    figure = Figure(figsize=(11, 4.8))
    whole, numerical = figure.subplots(1, 2, width_ratios=[3, 2])
    figure.subplots_adjust(left=0.065, right=0.99, bottom=0.11, top=0.8, wspace=0.18)
    _whole(whole, rows)
    _numerical(numerical, rows)
    for axes in (whole, numerical):
        axes.set(xscale="log", yscale="log")
        label_decades(axes.xaxis)
        label_decades(axes.yaxis)
        axes.grid(alpha=0.3)
    figure.savefig(path)


def _whole(axes: Axes, rows: Sequence[EndToEnd]) -> None:
    for place, name in enumerate(dict.fromkeys(row.estimator for row in rows)):
        own = [row for row in rows if row.estimator == name]
        marker, colour = mark(place)
        size = [14 * (row.gate_length_m / 0.5e-3) for row in own]
        axes.scatter(
            [row.time_s for row in own], [row.error for row in own], size,
            marker=marker, color=colour, alpha=0.7, label=name, linewidths=0.8,
        )  # fmt: skip
    front = sorted((row.time_s, row.error) for row in rows if row.on_front)
    axes.step(*zip(*front, strict=True), where="post", color="k", lw=1.2, label="Pareto front")
    _star(axes, [(row.time_s, row.error) for row in rows if row.shipped])
    for row in rows:
        if row.shipped:
            count = f"{row.realisations} realisation{'s' if row.realisations > 1 else ''}"
            axes.annotate(count, (row.time_s, row.error), (6, 8), textcoords="offset points", fontsize=7)
    axes.set(
        xlabel="processor time, scene to amplitude (s)",
        ylabel="rms error / true amplitude",
    )
    _legend_above(axes, "Final amplitude; larger marks: longer gates", 4)


def _numerical(axes: Axes, rows: Sequence[EndToEnd]) -> None:
    """Draw what tolerance and nodes alone do, over the run time of the most realisations."""
    most = max(row.realisations for row in rows)
    shipped = [row for row in rows if row.shipped and row.realisations == most]
    for name, marker, colour in (("tolerance", *MARKS[0]), ("nodes", *MARKS[1])):
        own = [row for row in rows if row.varied == name and row.realisations == most]
        times_s, errors = [row.time_s for row in own], [row.numerical_error for row in own]
        axes.plot(times_s, errors, marker, ms=6, color=colour, label=f"{name} varied")
        for row in own:
            text = f"{row.tolerance:.0e}" if name == "tolerance" else f"{row.nodes}"
            # Tolerances to the right of their marks, nodes to the left: the two may lie at one place.
            place, side = ((6, -3), "left") if name == "tolerance" else ((-6, -3), "right")
            axes.annotate(
                text, (row.time_s, row.numerical_error), place, textcoords="offset points", fontsize=7, ha=side
            )
    _star(axes, [(row.time_s, row.numerical_error) for row in shipped])
    for row in shipped:
        axes.axhline(row.standard_error, color="0.5", lw=0.8, ls="--", label=f"standard error of {most}")
    axes.margins(x=0.12)
    axes.set(
        xlabel=f"processor time of {most} realisations (s)",
        ylabel="rms numerical error / amplitude",
    )
    _legend_above(axes, "Of which tolerance and nodes", 2)


def _legend_above(axes: Axes, title: str, columns: int) -> None:
    """Put the legend with its title above the panel, where it covers nothing."""
    axes.legend(title=title, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=columns, frameon=False, fontsize=8)


def _star(axes: Axes, points: Sequence[tuple[float, float]]) -> None:
    if points:
        times_s, errors = zip(*points, strict=True)
        axes.plot(times_s, errors, "*", label="shipped default", ms=15, mfc="none", mec="k", mew=1.3, zorder=5)
