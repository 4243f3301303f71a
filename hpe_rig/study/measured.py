"""Cases measured whole: every realisation a simulated measurement of the scene, from the plan to the result.

Nothing of the scene is left out: specimen and its field, background, receive chain, jitter, interference, window,
estimator and its prior are those of ``hpe-rig run``. A draw is a new seed, and its noise realisations are repeats of
the shot over the same scatterers. Far slower than the gate alone (`engine.py`).
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Mapping
from functools import partial
from importlib.metadata import version
from pathlib import Path

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.measurement import prepare, record_run
from hpe_rig.processing import Estimator
from hpe_rig.result import Estimate, Result
from hpe_rig.runs import open_run
from hpe_rig.store import StoreError
from hpe_rig.study.engine import peak_memory_bytes, settled
from hpe_rig.study.measured_case import MeasuredCase
from hpe_rig.study.results import CaseRecord
from hpe_rig.study.statistics import errors, phase_errors

BETWEEN_LOOKS = 16
"""Draws after which it is asked whether a case is known well enough."""


def measure_case(case: MeasuredCase) -> CaseRecord:
    """Return the record of a case, every draw measured in a run file of its own that is then removed."""
    since = time.process_time()
    frequencies = len(case.scene.wanted_frequencies_hz)
    # (draw, noise, frequency, amplitude and phase: found, true, and whether the shot is warned of)
    found = {name: np.full((case.scatterers, case.noise, frequencies, 5), np.nan) for name in case.estimators}
    draws = 0
    while draws < case.scatterers and not settled(draws, case.standard_error_m, partial(_rows, case, found, draws)):
        for draw in range(draws, min(draws + BETWEEN_LOOKS, case.scatterers)):
            _measure(case, draw, {name: values[draw] for name, values in found.items()})
        draws = draw + 1
    return {
        "case": case.key,
        "estimates": _rows(case, found, draws),
        "draws": draws,
        "noise": case.noise,
        "seconds": time.process_time() - since,
        "peak_memory_bytes": peak_memory_bytes(),
        "version": version("hpe-rig"),
    }


def _measure(case: MeasuredCase, draw: int, found: Mapping[Estimator, FloatArray]) -> None:
    """Write what every estimator makes of a draw to ``found`` (noise, frequency, 5), NaN where it refuses."""
    with tempfile.TemporaryDirectory() as folder:
        run = open_run(record_run(prepare(case.seeded(draw)), Path(folder) / "run.h5"))
        for name, values in found.items():
            try:
                result = run.estimate(name)
            except StoreError:
                # Not one of its shots carries an estimate.
                continue
            _fill(values, result, case.corrected)


def _fill(values: FloatArray, result: Result, corrected: bool) -> None:
    for shot in result.shots:
        values[shot.shot] = [(*_numbers(each, corrected), bool(shot.warnings)) for each in shot.estimates]


def _numbers(each: Estimate, corrected: bool) -> tuple[float | None, ...]:
    """Return amplitude and phase, found and true; None becomes NaN."""
    found = each.headline if corrected else each
    return found.amplitude_m, found.phase_rad, each.true_amplitude_m, each.true_phase_rad


def _rows(case: MeasuredCase, found: Mapping[Estimator, FloatArray], draws: int) -> list[CaseRecord]:
    """Return bias and jitter of amplitude and phase, a row an estimator and frequency."""
    rows = []
    for name, every in found.items():
        for index, hz in enumerate(case.scene.wanted_frequencies_hz):
            amplitude_m, phase_rad, true_m, true_rad, warned = np.moveaxis(every[:draws, :, index], -1, 0)
            row: CaseRecord = {"estimator": name, "frequency_hz": hz, "amplitude_true_m": _first(true_m)}
            row |= errors(amplitude_m - true_m).named("amplitude", "m")
            row["phase_true_rad"] = _first(true_rad)
            row |= phase_errors(phase_rad - true_rad, 0.0).named("phase", "rad")
            row["refused"] = int(np.isnan(amplitude_m).sum())
            row["warned"] = int(np.nansum(warned))
            rows.append(row)
    return rows


def _first(values: FloatArray) -> float:
    """Return the first known of ``values``; a true value is that of every realisation but for jitter."""
    known = values[np.isfinite(values)]
    return float(known[0]) if known.size else float("nan")
