"""Combinations of a few exact echoes that make all the others: for small motion of few freedoms, whatever its shapes.

The phases ``exp(-j w tau_kn)`` of all echoes span few dimensions: as many as the motion has products of shapes above
the tolerance. A pivoted Gram-Schmidt on the phases of a sample of scatterers finds the echoes that span them and the
combinations that make the others of these. Whether that holds is checked on echoes that were held back.
docs/theory/echoes.md, section 3.
"""

from __future__ import annotations

import numpy as np

from sim_backend.arrays import ComplexArray, FloatArray, Int64Array
from sim_backend.echoes.exact_sums import running_sum
from sim_backend.echoes.pulse import Pulse

FEWEST_ECHOES = 128
LARGEST_SHARE = 0.4
"""Of the echoes that must be exact: beyond, the exact sum of all is as good."""
_PROBES = 192
_COLUMNS = 256
_HELD_BACK = 6


def combined(
    delay_s: FloatArray,
    weight: FloatArray,
    pulse: Pulse,
    sample_time_s: FloatArray,
    tolerance: float,
    colour: ComplexArray | None = None,
) -> tuple[FloatArray, int] | None:
    """Return the echoes (echo, sample) to ``tolerance`` of their rms and how many were exact; None where that fails.

    ``delay_s`` (echo, scatterer), ``weight`` (scatterer,), ``sample_time_s`` (sample,) ascending. A ``colour``, the
    same in all echoes, changes no combination.
    """
    some, combination = _skeleton(_phases(delay_s, weight, pulse), 0.1 * tolerance)
    if len(some) > LARGEST_SHARE * len(delay_s):
        return None
    others = np.setdiff1d(np.arange(len(delay_s)), some)
    held_back = others[np.linspace(0, len(others) - 1, min(_HELD_BACK, len(others))).astype(np.int64)]
    exact = running_sum(delay_s[np.concatenate([some, held_back])], weight, pulse, sample_time_s, colour)
    echo = combination @ exact[: len(some)]
    error = echo[held_back] - exact[len(some) :]
    if np.vdot(error, error) > tolerance**2 * np.vdot(exact[len(some) :], exact[len(some) :]):
        return None
    return np.asarray(echo), len(some)


def _phases(delay_s: FloatArray, weight: FloatArray, pulse: Pulse) -> FloatArray:
    """Return columns (echo, column) that mix the real and imaginary phases of some scatterers at both band edges."""
    rng = np.random.default_rng(0)
    # Scatterers spread over all weights, the heaviest included.
    heavy = np.argsort(np.abs(weight), kind="stable")[::-1]
    probe = heavy[np.unique(np.linspace(0, len(heavy) - 1, _PROBES).astype(np.int64))]
    moved_s = delay_s[:, probe] - delay_s[:, probe].mean(axis=0)
    hz = np.abs(pulse.frequency_hz)
    parts = [weight[probe] * np.exp(-2j * np.pi * edge * moved_s) for edge in np.unique([hz.min(), hz.max()])]
    columns = np.concatenate([part for phase in parts for part in (phase.real, phase.imag)], axis=1)
    mixed = columns @ rng.standard_normal((columns.shape[1], _COLUMNS))
    return np.asarray(mixed)


def _skeleton(rows: FloatArray, tolerance: float) -> tuple[Int64Array, FloatArray]:
    """Return some rows and the combination (row, some) that makes all rows of them, to ``tolerance`` of their rms."""
    # What of each row the directions found so far do not span; in every turn the longest becomes the next direction.
    left = rows.copy()
    most = min(rows.shape[1] - 32, int(LARGEST_SHARE * len(rows)) + 1)
    enough = tolerance**2 * float(np.vdot(rows, rows)) / len(rows)
    chosen: list[int] = []
    shares = np.empty((len(rows), most))
    while len(chosen) < most:
        size = np.einsum("kc,kc->k", left, left)
        farthest = int(np.argmax(size))
        if size[farthest] <= enough:
            break
        direction = left[farthest] / np.sqrt(size[farthest])
        share = left @ direction
        left -= share[:, None] * direction
        shares[:, len(chosen)] = share
        chosen.append(farthest)
    # Along the directions the chosen rows are a square matrix and all rows a tall one: solve for the combination.
    some = np.array(chosen, dtype=np.int64)
    shares = shares[:, : len(chosen)]
    return some, np.linalg.solve(shares[some].T, shares.T).T
