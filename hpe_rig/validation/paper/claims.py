"""Claims of the paper that are more than a trend over SNR: its numbers, its maps, its remarks."""

from __future__ import annotations

import itertools
import math

import numpy as np

from hpe_rig.study import PAPER_WIDTH_RATIO, StudyResult, lateral_average, with_error
from hpe_rig.validation.paper.judgement import (
    AGREES,
    DIFFERS,
    IN_PART,
    QUANTITIES,
    SIGNIFICANT,
    UNITS,
    UNTOLD,
    Judgement,
    at_point,
    below,
    ends,
    family,
    in_units,
    judge_of,
    map_of,
    number,
    span_of_largest,
)

NM, DEGREES = 1e9, 180 / math.pi


@judge_of
def at_highest_snr(
    result: StudyResult, reading: str, quantity: str, said: float, rounding: float,
    scale: float = 1.0, offset: float = 0.0, unit: str = "",
) -> Judgement:  # fmt: skip
    """Judge "bias" or "jitter" of the amplitude over the true one, ``offset`` + ``scale`` times it."""
    curve = ends(result, reading)[0]
    value, se, truth = (curve.values(f"amplitude_{name}_m")[-1] for name in (quantity, f"{quantity}_se", "true"))
    return number(offset + scale * value / truth, abs(scale) * se / truth, said, rounding, unit)


def levels_out(result: StudyResult, reading: str) -> Judgement:
    """Judge whether the mean is constant, to a hundredth of the amplitude, over the three highest SNRs."""
    curve = ends(result, reading)[0]
    bias, se = in_units(curve, "amplitude_bias")
    change, margin = float(np.ptp(bias[-3:])), family(3) * math.hypot(se[-1], se[-3])
    words = f"mean within {change:.2g} nm from {curve.x[-3]:g} to {curve.x[-1]:g} dB, s.e. {se[-1]:.2g} nm"
    limit = 0.01 * curve.rows[-1]["amplitude_true_m"] * NM
    return Judgement(words, AGREES if change < limit else DIFFERS if change - margin > limit else UNTOLD)


def no_phase_bias(result: StudyResult, reading: str) -> Judgement:
    """Judge whether the phase has a bias at any SNR."""
    curve = ends(result, reading)[0]
    bias, se = in_units(curve, "phase_bias")
    worst = int(np.argmax(np.abs(bias / se)))
    sigmas, chance = abs(bias[worst] / se[worst]), family(bias.size)
    words = f"at most {sigmas:.1f} s.e., {abs(bias[worst]):.2g} deg at {curve.x[worst]:g} dB"
    return Judgement(f"{words} (chance: {chance:.1f} of {bias.size})", AGREES if sigmas < chance else DIFFERS)


def falls_by_20_db(result: StudyResult, reading: str) -> Judgement:
    """Judge whether the displacement jitter has fallen at 20 dB."""
    curve = ends(result, reading)[0]
    jitter, se = in_units(curve, "amplitude_jitter")
    at = int(np.argmin(np.abs(curve.x - 20)))
    words = f"displacement jitter {jitter[0]:.3g}, {jitter[at]:.3g}, {jitter[-1]:.3g} nm at 0, 20, {curve.x[-1]:g} dB"
    return Judgement(words, AGREES if jitter[0] - jitter[at] > 3 * math.hypot(se[0], se[at]) else DIFFERS)


def hundred(result: StudyResult, reading: str) -> Judgement:
    """Judge what 100 realisations know of the mean at 20 dB."""
    curve = ends(result, reading)[0]
    at = int(np.argmin(np.abs(curve.x - 20)))
    row, se = curve.rows[at], curve.values("amplitude_bias_se_m")[at] * NM
    realisations = row["draws"] * row["noise"]
    of_hundred = se * math.sqrt(realisations / 100)
    words = f"mean at 20 dB to {se:.2g} nm from {realisations}, {of_hundred:.2g} nm from 100"
    return Judgement(words, AGREES if of_hundred < 0.02 * row["amplitude_true_m"] * NM else DIFFERS)


def map_ratio(result: StudyResult, reading: str) -> Judgement:
    """Judge the normalised displacement at W_x = W_y = 2.19, 0.82."""
    _, x, y, table = map_of(result, reading)[-1]
    truth = table["amplitude_true_m"]
    value = at_point(x, y, 1 + table["amplitude_bias_m"] / truth, PAPER_WIDTH_RATIO)
    return number(value, at_point(x, y, table["amplitude_bias_se_m"] / truth, PAPER_WIDTH_RATIO), 0.82, 0.005)


@judge_of
def phase_limit(result: StudyResult, reading: str, quantity: str) -> Judgement:
    """Judge 5 degrees as the most where both W exceed 0.5."""
    _, x, y, table = map_of(result, reading)[-1]
    wide = (x[None, :] > 0.5) & (y[:, None] > 0.5)
    value, se = (np.abs(table[f"{quantity}{of}_rad"])[wide] * DEGREES for of in ("", "_se"))
    return below(value, se, 5.0, " deg")


@judge_of
def map_trend(result: StudyResult, reading: str, quantity: str, falls: bool) -> Judgement:
    """Judge a trend along W_x = W_y: from first to last, and whether it first goes the other way."""
    _, x, _, table = map_of(result, reading)[-1]
    unit, scale, name = UNITS[quantity.split("_")[0]]
    value = np.abs(np.diagonal(table[f"{quantity}_{unit}"])) * scale
    se = np.diagonal(table[f"{quantity}_se_{unit}"]) * scale
    whole = (value[-1] - value[0]) / math.hypot(se[0], se[-1]) * (-1 if falls else 1)
    top = int(np.argmax(value if falls else -value))
    back = abs(value[top] - value[0]) / max(math.hypot(se[0], se[top]), 1e-300) > family(len(x)) and top > 0
    words = f"{QUANTITIES[quantity]} {value[0]:.3g} to {value[-1]:.3g} {name} along W_x = W_y"
    if back:
        words += f", but first to {value[top]:.3g} at W = {x[top]:.2g}"
    verdict = DIFFERS if whole < -SIGNIFICANT else UNTOLD if whole < SIGNIFICANT else AGREES
    return Judgement(words, IN_PART if back and verdict == AGREES else verdict)


def _differences(result: StudyResult, reading: str) -> list[tuple[float, float, float, float]]:
    """Return W_z, the largest difference from the lateral theory, and between which values the true one lies."""
    out = []
    for w_z, x, y, table in map_of(result, reading):
        truth = table["amplitude_true_m"]
        gap = np.abs(lateral_average(x[None, :], y[:, None]) - 1 - table["amplitude_bias_m"] / truth)
        out.append((w_z, float(gap.max()), *span_of_largest(gap, table["amplitude_bias_se_m"] / truth)))
    return sorted(out)


@judge_of
def difference_at(result: StudyResult, reading: str, which: int, said: float, and_more: bool = False) -> Judgement:
    """Judge the largest difference from the lateral theory at one W_z, in ascending order."""
    w_z, gap, low, high = _differences(result, reading)[which]
    # "Up to and greater than" and "as high as" are read off a figure: half a step of 0.05.
    agrees = said - 0.025 <= high and (and_more or low <= said + 0.025)
    words = f"at most {gap:.3f} at W_z = {w_z:g}, {low:.3f} to {high:.3f} with selection"
    return Judgement(words, UNTOLD if high - low > said else AGREES if agrees else DIFFERS)


def differences_fall(result: StudyResult, reading: str) -> Judgement:
    """Judge whether the largest difference falls from the least to the largest W_z, and rises nowhere between."""
    found = _differences(result, reading)
    rises = any(later[2] > earlier[3] for earlier, later in itertools.pairwise(found))
    falls, overlap = found[0][2] > found[-1][3], found[-1][2] <= found[0][3]
    words = "largest " + ", ".join(f"{gap:.2f} at {w_z:g}" for w_z, gap, *_ in found)
    return Judgement(words, (IN_PART if rises else AGREES) if falls else UNTOLD if overlap else DIFFERS)


def wider_axially(result: StudyResult, reading: str) -> Judgement:
    """Judge whether wider axial beams change the mean by less than the deviation that the paper states, 3.4 %."""
    curve = ends(result, reading)[0]
    ratio = 1 + curve.values("amplitude_bias_m") / curve.values("amplitude_true_m")
    jitter = curve.values("amplitude_jitter_m") / curve.values("amplitude_true_m")
    se = curve.values("amplitude_bias_se_m") / curve.values("amplitude_true_m")
    each = ", ".join(f"{r:.3f} ± {j:.3f} at {x:g}" for x, r, j in zip(curve.x, ratio, jitter, strict=True))
    low, high = span_of_largest(np.abs(ratio[1:] - ratio[0]), np.hypot(se[1:], se[0]))
    return Judgement(each, AGREES if high < 0.034 else DIFFERS if low > 0.034 else UNTOLD)


def phase_over_w_z(result: StudyResult, reading: str) -> Judgement:
    """Judge whether the phase jitter at W_x = W_y = 2.19 is constant to a tenth from W_z = 0.5 on."""
    found = [
        (w_z, *(at_point(x, y, table[f"phase_jitter{of}_rad"], PAPER_WIDTH_RATIO) * DEGREES for of in ("", "_se")))
        for w_z, x, y, table in map_of(result, reading)
    ]
    words = "phase jitter " + ", ".join(f"{with_error(value, se)} deg at {w_z:g}" for w_z, value, se in found)
    kept = np.array([each[1:] for each in found if each[0] >= 0.5])
    change, margin = float(np.ptp(kept[:, 0])), family(len(kept)) * float(np.hypot(*np.sort(kept[:, 1])[-2:]))
    limit = 0.1 * float(kept[:, 0].mean())
    verdict = AGREES if change + margin < limit else DIFFERS if change - margin > limit else UNTOLD
    return Judgement(words, verdict)
