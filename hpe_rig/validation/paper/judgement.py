"""Judgement of a statement of the paper by a study's own numbers and their Monte Carlo errors, in one reading."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hpe_rig.study import Curve, StudyResult, curves, maps, view

Floats = NDArray[np.float64]
Columns = dict[str, Floats]

SIGNIFICANT = 3.0
"""Standard errors: of 200 comparisons of nothing with nothing, one in two such pages shows one by chance."""
SHOWN_DB = 20.0
AGREES, IN_PART, DIFFERS, UNTOLD, ABSENT = "agrees", "in part", "differs", "not told", "not run"
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


def judged(results: Mapping[str, StudyResult], study: str, reading: str, judge: Judge) -> Judgement:
    """Return the finding, or that the study was not run in this reading."""
    result = results.get(study)
    if result is None or view(result, reading) is None:
        return Judgement(f"needs hpe-rig study {study}", ABSENT)
    return judge(result, reading)


def number(value: float, se: float, said: float, rounding: float, unit: str = "") -> Judgement:
    """Judge a number: it agrees within how it was rounded and three standard errors."""
    agrees = abs(value - said) <= rounding + SIGNIFICANT * se
    return Judgement(f"{with_error(value, se)}{unit}", AGREES if agrees else DIFFERS)


def below(largest: float, se: float, limit: float, unit: str) -> Judgement:
    """Judge an upper limit for the largest value found; what chance alone may lift above it tells nothing."""
    verdict = AGREES if largest < limit else UNTOLD if largest - SIGNIFICANT * se < limit else DIFFERS
    return Judgement(f"at most {with_error(largest, se)}{unit}", verdict)


def with_error(value: float, se: float) -> str:
    """Return a value and its standard error, both to the error's second digit."""
    if not 0 < se < math.inf:
        return f"{value:.4g}"
    digits = max(0, 1 - math.floor(math.log10(se)))
    return f"{value:.{digits}f} ± {se:.{digits}f}"


def ends(result: StudyResult, reading: str) -> tuple[Curve, Curve]:
    """Return the first and the last curve of the paper's chain in a reading."""
    one = view(result, reading)
    assert one is not None  # noqa: S101
    found = curves(result, one)
    return found[0], found[-1]


def trend(quantity: str, falls: bool) -> Judge:
    """Return the judge of a trend from the first to the last value of the parameter, at every SNR.

    It agrees where it shows significantly at some SNR and its opposite at none. Equal random numbers along the
    parameter make the standard errors upper bounds.
    """

    def judge(result: StudyResult, reading: str) -> Judgement:
        first, last = ends(result, reading)
        (a, a_se), (b, b_se) = _sizes(first, quantity), _sizes(last, quantity)
        z = (b - a) / np.maximum(np.hypot(a_se, b_se), 1e-300) * (-1 if falls else 1)
        right, wrong = z > SIGNIFICANT, z < -SIGNIFICANT
        shown = int(np.argmin(np.abs(first.x - SHOWN_DB)))
        _, _, unit = UNITS[quantity.split("_")[0]]
        words = f"{QUANTITIES[quantity]} {a[shown]:.3g} to {b[shown]:.3g} {unit} at {first.x[shown]:g} dB"
        words += f"; {'falls' if falls else 'rises'} at {_places(first.x, right)}"
        if wrong.any():
            words += f", {'rises' if falls else 'falls'} at {_places(first.x, wrong)}"
        if not right.any():
            return Judgement(words, DIFFERS if wrong.any() else UNTOLD)
        return Judgement(words, IN_PART if wrong.any() else AGREES)

    return judge


def flat(quantity: str, small: float, from_db: float = -math.inf) -> Judge:
    """Return the judge of "no effect": less than ``small`` (nm or degrees), or not significant, at every SNR."""

    def judge(result: StudyResult, reading: str) -> Judgement:
        first, last = ends(result, reading)
        (a, a_se), (b, b_se) = _sizes(first, quantity), _sizes(last, quantity)
        kept = first.x >= from_db
        change, se = np.abs(b - a)[kept], np.hypot(a_se, b_se)[kept]
        effect = (change > SIGNIFICANT * se) & (change > small)
        place = int(np.argmax(change))
        unit = UNITS[quantity.split("_")[0]][2]
        words = f"{QUANTITIES[quantity]} changes at most by {with_error(change[place], se[place])} {unit}"
        words += f", at {first.x[kept][place]:g} dB"
        if effect.any():
            words += f"; significantly at {_places(first.x[kept], effect)}"
        return Judgement(words, DIFFERS if effect.all() else IN_PART if effect.any() else AGREES)

    return judge


def slight(quantity: str, share: float, from_db: float = SHOWN_DB) -> Judge:
    """Return the judge of a small change: less than ``share`` of the value at the SNRs from ``from_db``."""

    def judge(result: StudyResult, reading: str) -> Judgement:
        first, last = ends(result, reading)
        (a, a_se), (b, b_se) = _sizes(first, quantity), _sizes(last, quantity)
        kept = first.x >= from_db
        ratio, se = (b / a - 1)[kept], (np.hypot(a_se / a, b_se / b) * np.abs(b / a))[kept]
        place = int(np.argmax(np.abs(ratio)))
        words = (
            f"{QUANTITIES[quantity]} {ratio[place] * 100:+.0f} ± {se[place] * 100:.1g} % at {first.x[kept][place]:g} dB"
        )
        return Judgement(words, AGREES if abs(ratio[place]) < share else DIFFERS)

    return judge


def map_of(result: StudyResult, reading: str) -> list[tuple[float, Floats, Floats, Columns]]:
    """Return W_z, W_x, W_y and the columns (y, x) of every map of the paper's chain."""
    one = view(result, reading)
    assert one is not None  # noqa: S101
    return [(float(values[0]), x, y, table) for values, x, y, table in maps(result, one)]


def at_point(x: Floats, y: Floats, values: Floats, place: float) -> float:
    """Return a map's value at x = y = ``place``, linear between points in the logarithm of both."""
    rows = [float(np.interp(math.log(place), np.log(x), row)) for row in values]
    return float(np.interp(math.log(place), np.log(y), rows))


def _sizes(curve: Curve, quantity: str) -> tuple[Floats, Floats]:
    """Return absolute value and standard error of a quantity, in nm or degrees."""
    unit, scale, _ = UNITS[quantity.split("_")[0]]
    return np.abs(curve.values(f"{quantity}_{unit}")) * scale, curve.values(f"{quantity}_se_{unit}") * scale


def _places(x: Floats, chosen: NDArray[np.bool_]) -> str:
    if not chosen.any():
        return "no SNR"
    return "every SNR" if chosen.all() else ", ".join(f"{value:g}" for value in x[chosen]) + " dB"
