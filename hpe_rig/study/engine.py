"""Engine of a study of the gate, from cases to bias and jitter, one block of draws at a time.

    draws of scatterers (stream, block) -> echoes                            once for equal echoes
    noise (stream, block) -> coefficients in the band                        once a batch
    echoes + level * noise -> displacement -> amplitude and phase            every case and estimator

The random numbers depend on the case's stream and the block's number alone: not on the batch, the order or the number
of draws. Memory is that of one block and of the estimates, for any number of realisations.
"""

from __future__ import annotations

import itertools
import operator
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from importlib.metadata import version
from pathlib import Path

import numpy as np

from hpe_rig.arrays import FloatArray, IndexArray
from hpe_rig.scene import Estimator
from hpe_rig.study.cases import Case
from hpe_rig.study.kernels import Form, form_of, spectral_kernels, states
from hpe_rig.study.results import CaseRecord
from hpe_rig.study.statistics import errors, phase_errors

TOLERANCE = 1e-7
"""Error of the echoes, rms relative to rms: 1 pm of motion."""
MIN_DRAWS = 64
"""Minimum number of draws for a reliable standard error."""
_NOISE_VALUES = 200_000
"""Noise values drawn at once; they fit the processor's cache."""
_DRAWS, _NOISE, _TAPERED_NOISE = 0, 1, 2


@dataclass(slots=True)
class _RunningCase:
    """A case during its computation: states (draw, noise, state) by estimator; the first ``draws`` are filled."""

    case: Case
    states: dict[str, FloatArray] = field(init=False)
    draws: int = 0
    seconds: float = 0.0
    finished: bool = False

    def __post_init__(self) -> None:
        shape = (self.case.scatterers, self.case.noise, self.case.train.state_count)
        self.states = {name: np.full(shape, np.nan) for name in self.case.estimators}


@dataclass(frozen=True, slots=True)
class _Echoes:
    """Noise-free echoes (draw, distinct displacement, sample), and the echo of every pulse (pulse,)."""

    cases: list[_RunningCase]
    volts: FloatArray
    echo_index: IndexArray


def run_batch(cases: Sequence[Case]) -> list[CaseRecord]:
    """Return one record for each case, in order; the cases must have the same ``noise_key``."""
    from sim_backend.echoes import DRAWS_AT_ONCE

    running = [_RunningCase(case) for case in cases]
    # Blocks bound the memory, and a case that is precise enough stops early.
    for first in range(0, cases[0].scatterers, DRAWS_AT_ONCE):
        active = [item for item in running if not item.finished]
        if not active:
            break
        draws = slice(first, min(first + DRAWS_AT_ONCE, cases[0].scatterers))
        _run_block(active, first // DRAWS_AT_ONCE, draws)
        for item in active:
            item.draws = draws.stop
            item.finished = is_precise(item.draws, item.case.standard_error_m, partial(_rows, item))
    return [
        {
            "case": item.case.key,
            "estimates": _rows(item),
            "draws": item.draws,
            "noise": item.case.noise,
            "seconds": item.seconds,
            "peak_memory_bytes": peak_memory_bytes(),
            "version": version("hpe-rig"),
        }
        for item in running
    ]


def is_precise(draws: int, standard_error_m: float | None, rows: Callable[[], list[CaseRecord]]) -> bool:
    """Return whether the mean amplitudes of all ``rows`` have at most this standard error; None: never."""
    if standard_error_m is None or draws < MIN_DRAWS:
        return False
    return all(row["amplitude_bias_se_m"] <= standard_error_m for row in rows())


def _run_block(active: list[_RunningCase], block: int, draws: slice) -> None:
    """Fill the states of every case for ``draws``."""
    since = time.process_time()
    # Cases that differ only in noise level or estimators have the same echoes, which are computed once.
    echoes = []
    key = operator.attrgetter("case.echoes_key")
    for _, group in itertools.groupby(sorted(active, key=key), key):
        cases = list(group)
        echoes.append(_echoes(cases, block, draws.stop - draws.start))
        since = _charge(cases, since)
    # All cases of a batch have the same unit noise: drawn once, in pieces that fit the cache.
    case = active[0].case
    generators = [
        np.random.default_rng(np.random.SeedSequence(case.stream, spawn_key=(stream, block)))
        for stream in (_NOISE, _TAPERED_NOISE)
    ]
    for piece, repeats in _pieces(case, draws.stop - draws.start):
        shape = (piece.stop - piece.start, repeats.stop - repeats.start, case.train.pulses)
        position = (slice(draws.start + piece.start, draws.start + piece.stop), repeats)
        noise = _unit_noise(active, shape, *generators)
        since = _charge(active, since)
        for item in echoes:
            since = _estimate(item, piece, noise, position, since)


def _echoes(cases: list[_RunningCase], block: int, draws: int) -> _Echoes:
    from sim_backend.echoes import drawn_echoes, echo_pulse

    case = cases[0].case
    train, twin = case.train, case.twin
    displacement_m = np.zeros(train.pulses)
    for motion in twin.motion or ():
        angle = 2 * np.pi * motion.frequency_hz * train.pulse_time_s + motion.phase_rad
        displacement_m += motion.amplitude_m * np.sin(angle)
    # Pulses at the same displacement, up to rounding, have the same echo.
    largest_m = float(np.abs(displacement_m).max(initial=0.0)) or 1.0
    _, first, echo_index = np.unique(np.round(displacement_m / largest_m, 12), return_index=True, return_inverse=True)
    # Time of the gate's samples after the echo of the focus at rest.
    centre = (train.samples - 1) / 2
    gate_s: FloatArray = np.asarray((np.arange(train.samples) - centre) / train.sample_rate_hz + case.gate_offset_s)
    rng = np.random.default_rng(np.random.SeedSequence(case.stream, spawn_key=(_DRAWS, block)))
    pulse = echo_pulse(twin, train.carrier_hz)
    chunks = list(drawn_echoes(twin, displacement_m[first], pulse, gate_s, rng, draws, TOLERANCE))
    return _Echoes(cases, np.asarray(np.concatenate(chunks), dtype=np.float64), echo_index)


def _pieces(case: Case, draws: int) -> Iterator[tuple[slice, slice]]:
    """Yield draws and noise realisations to be computed together; they depend on the case's sizes alone."""
    at_once = max(1, _NOISE_VALUES // (case.train.pulses * len(spectral_kernels(case.train).grid_hz["peak"])))
    for draw in range(0, draws, step := max(1, at_once // case.noise)):
        for first in range(0, case.noise, at_once):
            yield slice(draw, min(draw + step, draws)), slice(first, min(first + at_once, case.noise))


def _unit_noise(
    active: list[_RunningCase], shape: tuple[int, ...], peak: np.random.Generator, tapered: np.random.Generator
) -> dict[Form, FloatArray]:
    """Return unit noise (draw, noise, pulse, ...) in every form that an estimator of the batch needs.

    ``peak`` draws it for the paper's chain, ``tapered`` for all estimators of the tapered gate.
    """
    forms = {form_of(name) for item in active for name in item.case.estimators}
    kernels = spectral_kernels(active[0].case.train)
    noise: dict[Form, FloatArray] = {}
    for rng, group in ((peak, forms & {"peak"}), (tapered, forms - {"peak"})):
        if group:
            coefficients = rng.standard_normal((*shape, len(kernels.basis[min(group)])))
            noise |= {form: coefficients @ kernels.of_coefficients[form] for form in group}
    return noise


def _estimate(
    echoes: _Echoes, draws: slice, noise: dict[Form, FloatArray], position: tuple[slice, slice], since: float
) -> float:
    """Write the states of every case of these echoes for some ``draws`` of them; return the current processor time.

    ``noise`` is the unit noise by form, ``position`` the draws and repeats in the states (draw, noise).
    """
    train = echoes.cases[0].case.train
    volts = echoes.volts[draws]
    # Mean echo power of each draw over train and gate: as in the paper, the SNR holds for each draw.
    power = np.square(volts).mean(axis=2)[:, echoes.echo_index].mean(axis=1)
    clean = {form: volts @ matrix for form, matrix in spectral_kernels(train).of_volts.items() if form in noise}
    clean["volts"] = volts
    since = _charge(echoes.cases, since)
    # "literal" and "as_printed" differ in the scaling of an estimate alone: they share estimates and time.
    groups: dict[tuple[float | None, Estimator], list[_RunningCase]] = {}
    for item in echoes.cases:
        for name in item.case.estimators:
            groups.setdefault((item.case.twin.receiver.snr_db, name), []).append(item)
    for (snr_db, name), group in groups.items():
        level = np.zeros_like(power) if snr_db is None else np.sqrt(power / 10 ** (snr_db / 10))
        form = form_of(name)
        values = states(train, name, clean[form], echoes.echo_index, level, noise[form])
        for item in group:
            item.states[name][position] = values
        since = _charge(group, since)
    return since


def _charge(cases: list[_RunningCase], since: float) -> float:
    """Divide the processor time since ``since`` among ``cases``; return the current processor time."""
    now = time.process_time()
    for item in cases:
        item.seconds += (now - since) / len(cases)
    return now


def _rows(running: _RunningCase) -> list[CaseRecord]:
    """Return bias and jitter of amplitude and phase, a row for each estimator and frequency."""
    rows = []
    for name, all_states in running.states.items():
        values = all_states[: running.draws]
        if running.case.reading == "one_draw":
            # The noise realisations are the independent ones: they take the place of the draws.
            values = values.swapaxes(0, 1)
        for index, hz in enumerate(running.case.train.frequencies_hz):
            amplitude_m, phase_rad = _true_phasor(running.case, hz)
            in_phase, quadrature = values[..., 2 * index], values[..., 2 * index + 1]
            if running.case.reading == "as_printed":
                # A difference of pulses over their interval is a mean velocity. The chain divides by its gain.
                gain = np.sinc(hz / running.case.train.pulse_rate_hz)
                in_phase, quadrature = gain * in_phase, gain * quadrature
            row: CaseRecord = {"estimator": name, "frequency_hz": hz, "amplitude_true_m": amplitude_m}
            row |= errors(np.hypot(in_phase, quadrature) - amplitude_m).named("amplitude", "m")
            row["phase_true_rad"] = phase_rad
            row |= phase_errors(np.arctan2(quadrature, in_phase), phase_rad).named("phase", "rad")
            row["refused"] = int(np.isnan(in_phase).sum())
            rows.append(row)
    return rows


def _true_phasor(case: Case, hz: float) -> tuple[float, float]:
    """Return amplitude and phase of the prescribed motion at a frequency; motions of equal frequency add."""
    motions = [motion for motion in case.twin.motion or () if motion.frequency_hz == hz]
    phasor = sum(motion.amplitude_m * np.exp(1j * motion.phase_rad) for motion in motions)
    return float(np.abs(phasor)), float(np.angle(phasor))


def peak_memory_bytes() -> int:
    """Return the largest resident size of this process so far."""
    if sys.platform == "win32":
        return _peak_memory_windows()
    # On Linux `resource` inherits the counter of the parent process, so it is read from /proc.
    with suppress(OSError, StopIteration):
        lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
        return int(next(line for line in lines if line.startswith("VmHWM:")).split()[1]) * 1024
    import resource

    # Bytes on macOS, kibibytes elsewhere.
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def _peak_memory_windows() -> int:
    if sys.platform != "win32":  # the type checker skips the rest on other systems
        return 0
    import ctypes
    from ctypes import wintypes

    class Counters(ctypes.Structure):
        _fields_ = [("size", wintypes.DWORD), ("faults", wintypes.DWORD), ("peak", ctypes.c_size_t)] + [
            (f"other_{n}", ctypes.c_size_t) for n in range(7)
        ]

    counters = Counters(size=ctypes.sizeof(Counters))
    process = wintypes.HANDLE(-1)
    ctypes.windll.kernel32.K32GetProcessMemoryInfo(process, ctypes.byref(counters), counters.size)
    return int(counters.peak)
