"""Claims of the paper that are more than a trend over SNR: its numbers, its maps, its remarks."""

from __future__ import annotations

import itertools
import math

import numpy as np

from hpe_rig.study import OURS, StudyResult, lateral_average
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
    in_units,
    judge_of,
    map_of,
    number,
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


def lateral_theory(result: StudyResult, reading: str) -> Judgement:
    """Judge the 92 % of the lateral theory, which no draw enters."""
    theory = float(lateral_average(np.array(OURS), np.array(OURS)))
    power = 0.92 / (1 - 0.92) / OURS**2
    return Judgement(f"{theory:.4f} in closed form; 0.92 takes weights I^{power:.2f} in place of I^2", DIFFERS)


def levels_out(result: StudyResult, reading: str) -> Judgement:
    """Judge whether the mean is constant over the three highest SNRs."""
    curve = ends(result, reading)[0]
    bias, se = in_units(curve, "amplitude_bias")
    change = float(np.ptp(bias[-3:]))
    words = f"mean within {change:.2g} nm from {curve.x[-3]:g} to {curve.x[-1]:g} dB, s.e. {se[-1]:.2g} nm"
    return Judgement(words, AGREES if change < 3 * se[-1] else DIFFERS)


def no_phase_bias(result: StudyResult, reading: str) -> Judgement:
    """Judge whether the phase has a bias at any SNR."""
    curve = ends(result, reading)[0]
    bias, se = in_units(curve, "phase_bias")
    worst = int(np.argmax(np.abs(bias / se)))
    sigmas = abs(bias[worst] / se[worst])
    words = f"at most {sigmas:.1f} s.e., {abs(bias[worst]):.2g} deg at {curve.x[worst]:g} dB"
    return Judgement(words, AGREES if sigmas < 3 else DIFFERS)


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
    value = at_point(x, y, 1 + table["amplitude_bias_m"] / truth, OURS)
    return number(value, at_point(x, y, table["amplitude_bias_se_m"] / truth, OURS), 0.82, 0.005)


@judge_of
def phase_limit(result: StudyResult, reading: str, quantity: str) -> Judgement:
    """Judge 5 degrees as the most where both W exceed 0.5."""
    _, x, y, table = map_of(result, reading)[-1]
    wide = (x[None, :] > 0.5) & (y[:, None] > 0.5)
    value = np.abs(table[f"{quantity}_rad"])[wide] * DEGREES
    place = int(np.argmax(value))
    return below(value[place], table[f"{quantity}_se_rad"][wide][place] * DEGREES, 5.0, " deg")


@judge_of
def map_trend(result: StudyResult, reading: str, quantity: str, falls: bool) -> Judgement:
    """Judge a trend along W_x = W_y: from first to last, and whether it first goes the other way."""
    _, x, _, table = map_of(result, reading)[-1]
    unit, scale, name = UNITS[quantity.split("_")[0]]
    value = np.abs(np.diagonal(table[f"{quantity}_{unit}"])) * scale
    se = np.diagonal(table[f"{quantity}_se_{unit}"]) * scale
    whole = (value[-1] - value[0]) / math.hypot(se[0], se[-1]) * (-1 if falls else 1)
    top = int(np.argmax(value if falls else -value))
    back = abs(value[top] - value[0]) / max(math.hypot(se[0], se[top]), 1e-300) > SIGNIFICANT and top > 0
    words = f"{QUANTITIES[quantity]} {value[0]:.3g} to {value[-1]:.3g} {name} along W_x = W_y"
    if back:
        words += f", but first to {value[top]:.3g} at W = {x[top]:.2g}"
    verdict = DIFFERS if whole < -SIGNIFICANT else UNTOLD if whole < SIGNIFICANT else AGREES
    return Judgement(words, IN_PART if back and verdict == AGREES else verdict)


def _differences(result: StudyResult, reading: str) -> list[tuple[float, float, float]]:
    """Return W_z, the largest difference from the lateral theory and its standard error, by W_z."""
    out = []
    for w_z, x, y, table in map_of(result, reading):
        truth = table["amplitude_true_m"]
        gap = np.abs(lateral_average(x[None, :], y[:, None]) - 1 - table["amplitude_bias_m"] / truth)
        place = np.unravel_index(int(np.argmax(gap)), gap.shape)
        out.append((w_z, float(gap[place]), float((table["amplitude_bias_se_m"] / truth)[place])))
    return sorted(out)


@judge_of
def difference_at(result: StudyResult, reading: str, which: int, said: float) -> Judgement:
    """Judge the largest difference from the lateral theory at one W_z, in ascending order."""
    w_z, gap, se = _differences(result, reading)[which]
    # "Up to and greater than" and "as high as" are read off a figure: half a step of 0.05.
    finding = number(gap, se, said, 0.025)
    verdict = AGREES if which == 0 and gap > said else finding.verdict
    return Judgement(f"at most {finding.found} at W_z = {w_z:g}", verdict)


def differences_fall(result: StudyResult, reading: str) -> Judgement:
    """Judge whether the largest difference falls from the least to the largest W_z, and rises nowhere between."""
    found = _differences(result, reading)
    rises = any(b - a > SIGNIFICANT * math.hypot(s, t) for (_, a, s), (_, b, t) in itertools.pairwise(found))
    whole = found[0][1] - found[-1][1] > SIGNIFICANT * math.hypot(found[0][2], found[-1][2])
    words = "largest " + ", ".join(f"{gap:.2f} at {w_z:g}" for w_z, gap, _ in found)
    return Judgement(words, (IN_PART if rises else AGREES) if whole else DIFFERS)


def wider_axially(result: StudyResult, reading: str) -> Judgement:
    """Judge whether wider axial beams change the mean by less than its deviation."""
    curve = ends(result, reading)[0]
    ratio = 1 + curve.values("amplitude_bias_m") / curve.values("amplitude_true_m")
    jitter = curve.values("amplitude_jitter_m") / curve.values("amplitude_true_m")
    each = ", ".join(f"{r:.3f} ± {j:.3f} at {x:g}" for x, r, j in zip(curve.x, ratio, jitter, strict=True))
    return Judgement(each, AGREES if float(np.ptp(ratio)) < float(jitter[0]) else DIFFERS)


def phase_over_w_z(result: StudyResult, reading: str) -> Judgement:
    """Judge the phase jitter at W_x = W_y = 2.19 from W_z = 0.5 on."""
    found = [
        (w_z, at_point(x, y, table["phase_jitter_rad"], OURS) * DEGREES) for w_z, x, y, table in map_of(result, reading)
    ]
    kept = [value for w_z, value in found if w_z >= 0.5]
    words = "phase jitter " + ", ".join(f"{value:.2g} deg at {w_z:g}" for w_z, value in found)
    return Judgement(words, AGREES if max(kept) - min(kept) < 1.0 else DIFFERS)
