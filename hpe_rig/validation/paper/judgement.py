"""Judgement of a statement of the paper by a study's own numbers and their Monte Carlo errors, in one reading."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from statistics import NormalDist
from typing import Concatenate, ParamSpec

import numpy as np

from hpe_rig.arrays import BoolArray, FloatArray
from hpe_rig.study import Curve, StudyResult, View, curves, maps, paper_view, with_error

Columns = dict[str, FloatArray]
P = ParamSpec("P")

SIGNIFICANT = 3.0
"""Standard errors: of 200 comparisons of nothing with nothing, one in two such pages shows one by chance."""
SHOWN_DB = 20.0
JUDGED_DB = (0.0, 20.0, 40.0)
"""At each of these a trend must show: at 0 dB it is noise, at 40 dB speckle."""
LEVEL = 0.05
"""A change that is less than this share of the quantity, by three standard errors, is none."""
AGREES, IN_PART, DIFFERS, UNTOLD, ABSENT = "agrees", "in part", "differs", "inconclusive", "not run"
UNITS = {"amplitude": ("m", 1e9, "nm"), "phase": ("rad", 180 / math.pi, "deg")}
QUANTITIES = {
    "amplitude_bias": "displacement bias",
    "amplitude_jitter": "displacement jitter",
    "phase_bias": "phase bias",
    "phase_jitter": "phase jitter",
}


@dataclass(frozen=True, slots=True)
class Judgement:
    """What came out, in words, and the verdict on what was said."""

    found: str
    verdict: str


Judge = Callable[[StudyResult, str], Judgement]
"""From a study and a reading of eq. (11)."""


def judge_of(rule: Callable[Concatenate[StudyResult, str, P], Judgement]) -> Callable[P, Judge]:
    """Return ``rule`` (study, reading, what the paper says) as a function from what the paper says to its judge."""
    return lambda *said, **more: lambda result, reading: rule(result, reading, *said, **more)


def judged(results: Mapping[str, StudyResult], study: str, reading: str, judge: Judge) -> Judgement:
    """Return the finding, or that the study was not run in this reading."""
    result = results.get(study)
    if result is None or paper_view(result, reading) is None:
        return Judgement(f"needs hpe-rig study {study}", ABSENT)
    return judge(result, reading)


def number(value: float, se: float, said: float, rounding: float, unit: str = "") -> Judgement:
    """Judge a number: it agrees within how it was rounded and three standard errors."""
    agrees = abs(value - said) <= rounding + SIGNIFICANT * se
    return Judgement(f"{with_error(value, se)}{unit}", AGREES if agrees else DIFFERS)


def family(count: int) -> float:
    """Return how many standard errors are as rare, as the largest of ``count`` independent ones, as three of one.

    The largest of many found values is large by chance: what is said of it is judged by this (Sidak).
    """
    rare = 2 * NormalDist().cdf(-SIGNIFICANT)
    return -NormalDist().inv_cdf((1 - (1 - rare) ** (1 / max(count, 1))) / 2)


def span_of_largest(values: FloatArray, se: FloatArray) -> tuple[float, float]:
    """Return between which values the largest of the true values lies, selection included."""
    margin = family(values.size) * se
    return float((values - margin).max()), float((values + margin).max())


def below(values: FloatArray, se: FloatArray, limit: float, unit: str) -> Judgement:
    """Judge an upper limit for the largest of true values by those found and how far chance lifts the largest."""
    low, high = span_of_largest(values, se)
    verdict = AGREES if high < limit else DIFFERS if low > limit else UNTOLD
    return Judgement(f"at most {values.max():.3g}{unit}, {low:.3g} to {high:.3g} with selection", verdict)


def ends(result: StudyResult, reading: str) -> tuple[Curve, Curve]:
    """Return the first and the last curve of the paper's chain in a reading."""
    found = curves(result, _seen(result, reading))
    return found[0], found[-1]


@judge_of
def trend(result: StudyResult, reading: str, quantity: str, falls: bool) -> Judgement:
    """Judge a trend from the first to the last value of the parameter, at 0, 20 and 40 dB.

    It agrees where it is significant at all three, in part where at some; it differs where its opposite is significant
    at one and it at none, or where the quantity stays level at all three. Equal random numbers along the parameter make
    the standard errors upper bounds.
    """
    x, *found = _both_ends(result, reading, quantity)
    judged_at = sorted({int(np.argmin(np.abs(x - db))) for db in JUDGED_DB})
    a, a_se, b, b_se = (each[judged_at] for each in found)
    change, margin = b - a, SIGNIFICANT * np.hypot(a_se, b_se)
    right, wrong = (change < -margin, change > margin) if falls else (change > margin, change < -margin)
    level = ~(right | wrong) & (np.abs(change) + margin < LEVEL * np.maximum(a, b))
    unit, ways = UNITS[quantity.split("_")[0]][2], ("falls", "rises") if falls else ("rises", "falls")
    names = np.select([right, wrong, level], [*ways, "level"], "unclear")
    words = "; ".join(f"{x[n]:g} dB {a[k]:.3g} to {b[k]:.3g}, {names[k]}" for k, n in enumerate(judged_at))
    missed = DIFFERS if wrong.any() or level.all() else UNTOLD
    verdict = missed if not right.any() else AGREES if right.all() else IN_PART
    return Judgement(f"{QUANTITIES[quantity]} ({unit}): {words}", verdict)


@judge_of
def flat(result: StudyResult, reading: str, quantity: str, small: float, from_db: float = -math.inf) -> Judgement:
    """Judge "no effect": at every SNR less than ``small`` (nm or degrees), or what chance makes of the largest change.

    Inconclusive where chance alone makes more than twice ``small`` at SNRs from 20 dB on: nothing could then be seen.
    """
    x, a, a_se, b, b_se = _both_ends(result, reading, quantity, from_db)
    change, se = np.abs(b - a), np.hypot(a_se, b_se)
    effect = (change > family(change.size) * se) & (change > small)
    blind = bool((SIGNIFICANT * se[x >= SHOWN_DB] > 2 * small).any())
    place = int(np.argmax(change))
    unit = UNITS[quantity.split("_")[0]][2]
    words = f"{QUANTITIES[quantity]} changes at most by {with_error(change[place], se[place])} {unit}"
    words += f", at {x[place]:g} dB"
    if effect.any():
        words += f"; significantly at {_places(x, effect)}"
    verdict = DIFFERS if effect.all() else IN_PART if effect.any() else UNTOLD if blind else AGREES
    return Judgement(words, verdict)


@judge_of
def slight(result: StudyResult, reading: str, quantity: str, share: float) -> Judgement:
    """Judge a small change: less than ``share`` of the value at the SNRs from 20 dB on."""
    x, a, a_se, b, b_se = _both_ends(result, reading, quantity, SHOWN_DB)
    ratio, se = b / a - 1, np.hypot(a_se / a, b_se / b) * np.abs(b / a)
    place = int(np.argmax(np.abs(ratio)))
    low, high = span_of_largest(np.abs(ratio), se)
    words = f"{QUANTITIES[quantity]} {ratio[place] * 100:+.0f} ± {se[place] * 100:.1g} % at {x[place]:g} dB"
    return Judgement(words, AGREES if high < share else DIFFERS if low > share else UNTOLD)


def map_of(result: StudyResult, reading: str) -> list[tuple[float, FloatArray, FloatArray, Columns]]:
    """Return W_z, W_x, W_y and the columns (y, x) of every map of the paper's chain."""
    tables = maps(result, _seen(result, reading))
    return [(float(table.outer_values[0]), table.x, table.y, table.columns) for table in tables]


def at_point(x: FloatArray, y: FloatArray, values: FloatArray, place: float) -> float:
    """Return a map's value at x = y = ``place``, linear between points in the logarithm of both."""
    rows = [float(np.interp(math.log(place), np.log(x), row)) for row in values]
    return float(np.interp(math.log(place), np.log(y), rows))


def in_units(curve: Curve, quantity: str) -> tuple[FloatArray, FloatArray]:
    """Return value and standard error of a quantity along a curve, in nm or degrees."""
    unit, scale, _ = UNITS[quantity.split("_")[0]]
    return curve.values(f"{quantity}_{unit}") * scale, curve.values(f"{quantity}_se_{unit}") * scale


def _seen(result: StudyResult, reading: str) -> View:
    one = paper_view(result, reading)
    assert one is not None  # noqa: S101
    return one


def _both_ends(result: StudyResult, reading: str, quantity: str, from_db: float = -math.inf) -> tuple[FloatArray, ...]:
    """Return SNR, absolute value and error on the first curve, value and error on the last, all (SNR,)."""
    first, last = ends(result, reading)
    (a, a_se), (b, b_se) = in_units(first, quantity), in_units(last, quantity)
    kept = first.x >= from_db
    return first.x[kept], np.abs(a)[kept], a_se[kept], np.abs(b)[kept], b_se[kept]


def _places(x: FloatArray, chosen: BoolArray) -> str:
    if not chosen.any():
        return "no SNR"
    return "every SNR" if chosen.all() else ", ".join(f"{value:g}" for value in x[chosen]) + " dB"
