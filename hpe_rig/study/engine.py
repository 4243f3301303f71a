"""Engine of a study, from cases to bias and jitter: equal draws and noise are shared, a block of draws at a time.

    draws of scatterers (stream, block) -> echoes                            once for equal echoes
    noise (stream, block) -> numbers in the band                             once a batch
    echoes + level * noise -> displacement -> amplitude and phase            every case and estimator

Random numbers belong to the case's stream and the block's number: neither batch nor order nor how many draws follow
changes them. Memory is that of one block, whatever the number of realisations, and the estimates.
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
from hpe_rig.processing import Estimator
from hpe_rig.study.cases import Case
from hpe_rig.study.kernels import Form, form_of, spectral_kernels, states
from hpe_rig.study.results import CaseRecord
from hpe_rig.study.statistics import errors, phase_errors

TOLERANCE = 1e-7
"""Of the echoes, rms over rms: 1 pm of motion."""
LEAST_DRAWS = 64
"""Draws before a standard error is believed."""
_NOISE_VALUES = 200_000
"""Noise values made at once: what fits the cache."""
_DRAWS, _NOISE, _TAPERED_NOISE = 0, 1, 2


@dataclass(slots=True)
class _Running:
    """A case while it runs: states (draw, noise, 2 * frequency) by estimator, of which ``draws`` are there."""

    case: Case
    states: dict[str, FloatArray] = field(init=False)
    draws: int = 0
    seconds: float = 0.0
    finished: bool = False

    def __post_init__(self) -> None:
        shape = (self.case.scatterers, self.case.noise, 2 * len(self.case.train.frequencies_hz))
        self.states = {name: np.full(shape, np.nan) for name in self.case.estimators}


@dataclass(frozen=True, slots=True)
class _Echoes:
    """Noise-free echoes (draw, distinct displacement, sample) and which of them every pulse gets (pulse,)."""

    cases: list[_Running]
    volts: FloatArray
    which: IndexArray


def run_batch(cases: Sequence[Case]) -> list[CaseRecord]:
    """Return one record a case, in their order; the cases must have the same ``noise_key``."""
    from sim_backend.echoes import DRAWS_AT_ONCE

    running = [_Running(case) for case in cases]
    # In blocks, so that memory does not grow with the draws and a case that is precise enough stops early.
    for first in range(0, cases[0].scatterers, DRAWS_AT_ONCE):
        active = [one for one in running if not one.finished]
        if not active:
            break
        draws = slice(first, min(first + DRAWS_AT_ONCE, cases[0].scatterers))
        _run_block(active, first // DRAWS_AT_ONCE, draws)
        for one in active:
            one.draws = draws.stop
            one.finished = settled(one.draws, one.case.standard_error_m, partial(_rows, one))
    common = {"peak_memory_bytes": peak_memory_bytes(), "version": version("hpe-rig")}
    return [
        {
            "case": one.case.key,
            "estimates": _rows(one),
            "draws": one.draws,
            "noise": one.case.noise,
            "seconds": one.seconds,
            **common,
        }
        for one in running
    ]


def settled(draws: int, standard_error_m: float | None, rows: Callable[[], list[CaseRecord]]) -> bool:
    """Return whether after so many draws the means of all ``rows`` are known as well as wanted; None: never."""
    if standard_error_m is None or draws < LEAST_DRAWS:
        return False
    return all(row["amplitude_bias_se_m"] <= standard_error_m for row in rows())


def _run_block(active: list[_Running], block: int, draws: slice) -> None:
    """Fill in the states of every case for ``draws``."""
    since = time.process_time()
    # Cases that differ in the noise's level alone, or in the estimators, have the same echoes: they are made once.
    echoes = []
    key = operator.attrgetter("case.echoes_key")
    for _, group in itertools.groupby(sorted(active, key=key), key):
        own = list(group)
        echoes.append(_echoes(own, block, draws.stop - draws.start))
        since = _charge(own, since)
    # All cases of a batch have the same noise but for its level: drawn once, at unit level, in parts that fit a cache.
    case = active[0].case
    rngs = [
        np.random.default_rng(np.random.SeedSequence(case.stream, spawn_key=(stream, block)))
        for stream in (_NOISE, _TAPERED_NOISE)
    ]
    for some, repeats in _parts(case, draws.stop - draws.start):
        shape = (some.stop - some.start, repeats.stop - repeats.start, case.train.pulses)
        noise = _in_forms(active, shape, *rngs)
        since = _charge(active, since)
        place = (slice(draws.start + some.start, draws.start + some.stop), repeats)
        for made in echoes:
            since = _estimate(made, some, place, noise, since)


def _echoes(cases: list[_Running], block: int, draws: int) -> _Echoes:
    from sim_backend.echoes import drawn_echoes, echo_pulse

    case = cases[0].case
    train, twin = case.train, case.twin
    displacement_m = np.zeros(train.pulses)
    for part in twin.motion or ():
        angle = 2 * np.pi * part.frequency_hz * train.pulse_time_s + part.phase_rad
        displacement_m += part.amplitude_m * np.sin(angle)
    # Pulses that meet the same displacement, but for rounding, get the same echo.
    largest_m = float(np.abs(displacement_m).max(initial=0.0)) or 1.0
    _, first, which = np.unique(np.round(displacement_m / largest_m, 12), return_index=True, return_inverse=True)
    # The gate's samples in time after the echo of the resting focus.
    middle = (train.samples - 1) / 2
    gate_s: FloatArray = np.asarray((np.arange(train.samples) - middle) / train.sample_rate_hz + case.gate_offset_s)
    rng = np.random.default_rng(np.random.SeedSequence(case.stream, spawn_key=(_DRAWS, block)))
    pulse = echo_pulse(twin, train.carrier_hz)
    chunks = list(drawn_echoes(twin, displacement_m[first], pulse, gate_s, rng, draws, TOLERANCE))
    return _Echoes(cases, np.asarray(np.concatenate(chunks), dtype=np.float64), which)


def _parts(case: Case, draws: int) -> Iterator[tuple[slice, slice]]:
    """Yield draws and noise realisations that are done together: few, and by the case's own numbers alone."""
    at_once = max(1, _NOISE_VALUES // (case.train.pulses * len(spectral_kernels(case.train).grid_hz["peak"])))
    for draw in range(0, draws, step := max(1, at_once // case.noise)):
        for first in range(0, case.noise, at_once):
            yield slice(draw, min(draw + step, draws)), slice(first, min(first + at_once, case.noise))


def _in_forms(
    active: list[_Running], shape: tuple[int, ...], peak: np.random.Generator, others: np.random.Generator
) -> dict[Form, FloatArray]:
    """Return unit noise (draw, noise, pulse, ...) in every form that an estimator of the batch takes.

    Drawn by ``peak`` for the paper's chain and by ``others`` for all that see the tapered gate, where there are any.
    """
    wanted = {form_of(name) for one in active for name in one.case.estimators}
    seen = spectral_kernels(active[0].case.train)
    out: dict[Form, FloatArray] = {}
    for rng, forms in ((peak, wanted & {"peak"}), (others, wanted - {"peak"})):
        if forms:
            numbers = rng.standard_normal((*shape, len(seen.basis[min(forms)])))
            out |= {form: numbers @ seen.of_numbers[form] for form in forms}
    return out


def _estimate(
    made: _Echoes, some: slice, place: tuple[slice, slice], noise: dict[Form, FloatArray], since: float
) -> float:
    """Write the states of every case of these echoes at ``place`` (draw, noise); return the time it is."""
    train = made.cases[0].case.train
    volts = made.volts[some]
    # Mean echo power of each draw over the train, in the gate: noise is set draw by draw, as the paper's SNR is.
    power = np.square(volts).mean(axis=2)[:, made.which].mean(axis=1)
    clean = {form: volts @ columns for form, columns in spectral_kernels(train).of_volts.items() if form in noise}
    clean["volts"] = volts
    since = _charge(made.cases, since)
    # Readings that differ in what is made of an estimate alone, "literal" and "as_printed", share estimates and time.
    sharing: dict[tuple[float | None, Estimator], list[_Running]] = {}
    for one in made.cases:
        for name in one.case.estimators:
            sharing.setdefault((one.case.twin.receiver.snr_db, name), []).append(one)
    for (snr_db, name), alike in sharing.items():
        level = np.zeros_like(power) if snr_db is None else np.sqrt(power / 10 ** (snr_db / 10))
        form = form_of(name)
        found = states(train, name, clean[form], made.which, level, noise[form])
        for one in alike:
            one.states[name][place] = found
        since = _charge(alike, since)
    return since


def _charge(cases: list[_Running], since: float) -> float:
    """Share the processor time since ``since`` among ``cases``; return the time it is."""
    now = time.process_time()
    for one in cases:
        one.seconds += (now - since) / len(cases)
    return now


def _rows(one: _Running) -> list[CaseRecord]:
    """Return bias and jitter of amplitude and phase, a row an estimator and frequency."""
    rows = []
    for name, every in one.states.items():
        found = every[: one.draws]
        if one.case.reading == "one_draw":
            # Its realisations are those of the noise: they are what is independent, and what errors are told from.
            found = found.swapaxes(0, 1)
        for index, hz in enumerate(one.case.train.frequencies_hz):
            amplitude_m, phase_rad = _true(one.case, hz)
            in_phase, quadrature = found[..., 2 * index], found[..., 2 * index + 1]
            if one.case.reading == "as_printed":
                # A difference of pulses over their interval is a mean velocity; the chain takes its gain off.
                gain = np.sinc(hz / one.case.train.pulse_rate_hz)
                in_phase, quadrature = gain * in_phase, gain * quadrature
            row: CaseRecord = {"estimator": name, "frequency_hz": hz, "amplitude_true_m": amplitude_m}
            row |= errors(np.hypot(in_phase, quadrature) - amplitude_m).named("amplitude", "m")
            row["phase_true_rad"] = phase_rad
            row |= phase_errors(np.arctan2(quadrature, in_phase), phase_rad).named("phase", "rad")
            row["refused"] = int(np.isnan(in_phase).sum())
            rows.append(row)
    return rows


def _true(case: Case, hz: float) -> tuple[float, float]:
    """Return amplitude and phase of the prescribed motion at a frequency; equal frequencies add up."""
    parts = [part for part in case.twin.motion or () if part.frequency_hz == hz]
    phasor = sum(part.amplitude_m * np.exp(1j * part.phase_rad) for part in parts)
    return float(np.abs(phasor)), float(np.angle(phasor))


def peak_memory_bytes() -> int:
    """Return the largest resident size of this process so far."""
    if sys.platform == "win32":
        import ctypes
        from ctypes import wintypes

        class Counters(ctypes.Structure):
            _fields_ = [("size", wintypes.DWORD), ("faults", wintypes.DWORD), ("peak", ctypes.c_size_t)] + [
                (f"other_{n}", ctypes.c_size_t) for n in range(7)
            ]

        counters = Counters(size=ctypes.sizeof(Counters))
        this = wintypes.HANDLE(-1)
        ctypes.windll.kernel32.K32GetProcessMemoryInfo(this, ctypes.byref(counters), counters.size)
        return int(counters.peak)
    # On Linux the counter of `resource` is inherited: a worker would have its parent's peak.
    with suppress(OSError, StopIteration):
        lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
        return int(next(line for line in lines if line.startswith("VmHWM:")).split()[1]) * 1024
    import resource

    # Kibibytes, bytes on macOS.
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
