"""Judge a statement of the paper from the results of a study, for one reading of eq. (11) at a time.

Values are Monte Carlo means or jitters with standard errors. A difference is significant beyond three standard errors,
and the largest of n values beyond ``sidak_quantile(n)`` of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from statistics import NormalDist
from typing import Concatenate, ParamSpec

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.study import Curve, StudyResult, View, curves, paper_view, with_error

P = ParamSpec("P")

SIGNIFICANT = 3.0
"""Standard errors. A page of 200 comparisons without any difference has one beyond them in every second case."""
HIGH_SNR_DB = 20.0
TREND_SNR_DB = (0.0, 20.0, 40.0)
"""A trend must hold at each of these: noise dominates at 0 dB, speckle at 40 dB."""
LEVEL = 0.05
"""A relative change that is significantly below this counts as none."""
AGREES, IN_PART, DIFFERS, INCONCLUSIVE, NOT_RUN = "agrees", "in part", "differs", "inconclusive", "not run"
NOT_DECIDED = "not decided"
UNITS = {"amplitude": ("m", 1e9, "nm"), "phase": ("rad", 180 / math.pi, "deg")}
"""Suffix of the stored column, factor to the printed unit, and the printed unit."""
QUANTITIES = {
    "amplitude_bias": "displacement bias",
    "amplitude_jitter": "displacement jitter",
    "phase_bias": "phase bias",
    "phase_jitter": "phase jitter",
}


@dataclass(frozen=True, slots=True)
class Judgement:
    """The result of the study in words with its Monte Carlo error, and the verdict on the statement.

    ``decided``: no more draws of the same values could change the verdict, at three standard errors.
    """

    finding: str
    verdict: str
    decided: bool = True

    @property
    def text(self) -> str:
        """The verdict, followed by "not decided" where more draws could change it."""
        return self.verdict if self.decided or self.verdict == INCONCLUSIVE else f"{self.verdict}, {NOT_DECIDED}"


Judge = Callable[[StudyResult, str], Judgement]
"""Judges one statement from a study and the name of a reading."""


def judge_factory(rule: Callable[Concatenate[StudyResult, str, P], Judgement]) -> Callable[P, Judge]:
    """Return a function that takes the numbers stated by the paper and returns a judge by ``rule``."""
    return lambda *stated, **options: lambda result, reading: rule(result, reading, *stated, **options)


def is_run(result: StudyResult | None, reading: str) -> bool:
    """Return whether the study was run with the paper's chain in this reading."""
    return result is not None and paper_view(result, reading) is not None


def number(value: float, se: float, stated: float, rounding: float, unit: str = "") -> Judgement:
    """Judge a number: it agrees within its rounding and three standard errors.

    Agreement is decided if three standard errors are at most ``LEVEL`` of the number: few draws agree with anything.
    """
    agrees = abs(value - stated) <= rounding + SIGNIFICANT * se
    decided = not agrees or SIGNIFICANT * se <= max(rounding, LEVEL * abs(stated))
    return Judgement(f"{with_error(value, se)}{unit}", AGREES if agrees else DIFFERS, decided)


def sidak_quantile(count: int) -> float:
    """Return the bound, in standard errors, for the largest of ``count`` independent normal values.

    The largest exceeds it as rarely as a single value exceeds three standard errors (Sidak correction).
    """
    exceedance = 2 * NormalDist().cdf(-SIGNIFICANT)
    return -NormalDist().inv_cdf((1 - (1 - exceedance) ** (1 / max(count, 1))) / 2)


def bounds_of_largest(values: FloatArray, se: FloatArray) -> tuple[float, float]:
    """Return lower and upper bound of the largest true value, given estimates with standard errors."""
    margin = sidak_quantile(values.size) * se
    return float((values - margin).max()), float((values + margin).max())


def below(values: FloatArray, se: FloatArray, limit: float, unit: str) -> Judgement:
    """Judge an upper limit for the largest true value."""
    low, high = bounds_of_largest(values, se)
    verdict = AGREES if high < limit else DIFFERS if low > limit else INCONCLUSIVE
    return Judgement(f"largest {values.max():.3g}{unit}, true value between {low:.3g} and {high:.3g}", verdict)


def paper_curves(result: StudyResult, reading: str) -> list[Curve]:
    """Return the curves over SNR of the paper's chain in a reading, one per value of the parameter."""
    return curves(result, require_view(result, reading))


def require_view(result: StudyResult, reading: str) -> View:
    """Return the rows of the paper's chain in a reading that was run."""
    view = paper_view(result, reading)
    assert view is not None  # noqa: S101
    return view


@judge_factory
def trend(result: StudyResult, reading: str, quantity: str, falls: bool) -> Judgement:
    """Judge a trend from the first to the last value of the parameter, at 0, 20 and 40 dB.

    Agrees: significant at all three SNRs; in part: at some. Differs: the opposite trend is significant at one and the
    stated one at none, or the quantity is level at all three. The standard errors are upper bounds, because all values
    of the parameter share their random numbers.
    """
    snr_db, value, se = _first_and_last(result, reading, quantity)
    columns = sorted({int(np.argmin(np.abs(snr_db - db))) for db in TREND_SNR_DB})
    first, last = value[:, columns]
    change, margin = last - first, SIGNIFICANT * np.hypot(*se[:, columns])
    # Three standard errors of the difference of two independent values.
    stated, opposite = (change < -margin, change > margin) if falls else (change > margin, change < -margin)
    level = ~(stated | opposite) & (np.abs(change) + margin < LEVEL * np.maximum(first, last))

    directions = ("falls", "rises") if falls else ("rises", "falls")
    names = np.select([stated, opposite, level], [*directions, "level"], "unclear")
    values = zip(snr_db[columns], first, last, margin / SIGNIFICANT, names, strict=True)
    text = "; ".join(
        f"{db:g} dB {_digits(start, 3)} to {_digits(end, 3)} ± {_digits(u, 2)}, {name}"
        for db, start, end, u, name in values
    )

    # Without a significant trend, an opposite or level quantity contradicts the statement.
    otherwise = DIFFERS if opposite.any() or level.all() else INCONCLUSIVE
    verdict = otherwise if not stated.any() else AGREES if stated.all() else IN_PART
    # An unclear SNR can still become one of the three, except beside two that contradict each other.
    decided = (stated | opposite | level).all() or (stated.any() and (opposite | level).any())
    return Judgement(f"{QUANTITIES[quantity]} ({_printed_unit(quantity)}): {text}", verdict, bool(decided))


def _digits(value: float, digits: int) -> str:
    """Return ``value`` with ``digits`` significant digits, without an exponent: 1300."""
    return f"{float(f'{value:.{digits}g}'):g}"


@judge_factory
def flat(result: StudyResult, reading: str, quantity: str, negligible: float, from_db: float = -math.inf) -> Judgement:
    """Judge "no effect": the change is below ``negligible`` (nm or degrees), or insignificant, at every SNR.

    Inconclusive if a change of twice ``negligible`` could be insignificant at an SNR of 20 dB or more.
    """
    snr_db, (first, last), (first_se, last_se) = _first_and_last(result, reading, quantity, from_db)
    change, se = np.abs(last - first), np.hypot(first_se, last_se)
    effect = (change > sidak_quantile(change.size) * se) & (change > negligible)
    # The noise must not hide an effect twice as large as the negligible one.
    insensitive = bool((SIGNIFICANT * se[snr_db >= HIGH_SNR_DB] > 2 * negligible).any())

    largest = int(np.argmax(change))
    text = f"{QUANTITIES[quantity]} changes at most by {with_error(change[largest], se[largest])} "
    text += f"{_printed_unit(quantity)}, at {snr_db[largest]:g} dB"
    if effect.any():
        significant = ", ".join(f"{value:g}" for value in snr_db[effect]) + " dB"
        text += f"; significantly at {'every SNR' if effect.all() else significant}"
    verdict = DIFFERS if effect.all() else IN_PART if effect.any() else INCONCLUSIVE if insensitive else AGREES
    return Judgement(text, verdict, not insensitive or verdict == DIFFERS)


@judge_factory
def slight(result: StudyResult, reading: str, quantity: str, max_change: float) -> Judgement:
    """Judge a small change: relative change below ``max_change`` at SNRs of 20 dB and more."""
    snr_db, (first, last), (first_se, last_se) = _first_and_last(result, reading, quantity, HIGH_SNR_DB)
    # Relative change, with the standard error of a ratio.
    change, se = last / first - 1, np.hypot(first_se / first, last_se / last) * np.abs(last / first)
    largest = int(np.argmax(np.abs(change)))
    low, high = bounds_of_largest(np.abs(change), se)
    percent = f"{change[largest] * 100:+.0f} ± {se[largest] * 100:.1g} %"
    verdict = AGREES if high < max_change else DIFFERS if low > max_change else INCONCLUSIVE
    return Judgement(f"{QUANTITIES[quantity]} {percent} at {snr_db[largest]:g} dB", verdict)


def in_units(curve: Curve, quantity: str) -> tuple[FloatArray, FloatArray]:
    """Return value and standard error of a quantity along a curve, in nm or degrees."""
    suffix, scale, _ = UNITS[quantity.split("_")[0]]
    return curve.values(f"{quantity}_{suffix}") * scale, curve.values(f"{quantity}_se_{suffix}") * scale


def _printed_unit(quantity: str) -> str:
    return UNITS[quantity.split("_")[0]][2]


def _first_and_last(
    result: StudyResult, reading: str, quantity: str, from_db: float = -math.inf
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return SNR (SNR,), absolute value and standard error (2, SNR) of the first and the last curve."""
    first, *_, last = paper_curves(result, reading)
    value, se = np.stack([in_units(first, quantity), in_units(last, quantity)], axis=1)
    selected = first.x >= from_db
    return first.x[selected], np.abs(value[:, selected]), se[:, selected]
