"""Judges of the paper's numbers, maps and remarks, which are more than a trend over a parameter."""

from __future__ import annotations

import itertools
import math

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.study import PAPER_WIDTH_RATIO, StudyResult, lateral_average, maps, with_error
from hpe_rig.validation.paper.judgement import (
    AGREES,
    DIFFERS,
    HIGH_SNR_DB,
    IN_PART,
    INCONCLUSIVE,
    LEVEL,
    QUANTITIES,
    SIGNIFICANT,
    UNITS,
    Judgement,
    below,
    bounds_of_largest,
    in_units,
    judge_factory,
    number,
    paper_curves,
    require_view,
    sidak_quantile,
)

NM, DEGREES = 1e9, 180 / math.pi
Columns = dict[str, FloatArray]


@judge_factory
def at_highest_snr(
    result: StudyResult, reading: str, quantity: str, stated: float, rounding: float,
    scale: float = 1.0, offset: float = 0.0, unit: str = "",
) -> Judgement:  # fmt: skip
    """Judge ``offset`` + ``scale`` times the relative "bias" or "jitter" of the amplitude at the highest SNR."""
    curve = paper_curves(result, reading)[0]
    value, se, truth = (curve.values(f"amplitude_{name}_m")[-1] for name in (quantity, f"{quantity}_se", "true"))
    return number(offset + scale * value / truth, abs(scale) * se / truth, stated, rounding, unit)


def levels_out(result: StudyResult, reading: str) -> Judgement:
    """Judge whether the mean changes by less than 1 % of the amplitude over the three highest SNRs."""
    curve = paper_curves(result, reading)[0]
    bias, se = in_units(curve, "amplitude_bias")
    change, margin = float(np.ptp(bias[-3:])), sidak_quantile(3) * math.hypot(se[-1], se[-3])
    limit = 0.01 * curve.rows[-1]["amplitude_true_m"] * NM
    text = f"mean within {change:.2g} nm from {curve.x[-3]:g} to {curve.x[-1]:g} dB, standard error {se[-1]:.2g} nm"
    verdict = AGREES if change < limit else DIFFERS if change - margin > limit else INCONCLUSIVE
    # The draws are common to all SNRs: the change is known far better than the margin, an upper bound, states.
    return Judgement(text, verdict)


def no_phase_bias(result: StudyResult, reading: str) -> Judgement:
    """Judge whether the phase bias is insignificant at every SNR."""
    curve = paper_curves(result, reading)[0]
    bias, se = in_units(curve, "phase_bias")
    largest = int(np.argmax(np.abs(bias / se)))
    ratio, limit = abs(bias[largest] / se[largest]), sidak_quantile(bias.size)
    text = f"at most {ratio:.1f} standard errors, {abs(bias[largest]):.2g} deg at {curve.x[largest]:g} dB"
    # A bias of one degree from 20 dB on would be significant.
    sensitive = bool((SIGNIFICANT * se[curve.x >= HIGH_SNR_DB] < 1.0).all())
    text = f"{text} (limit {limit:.1f} for {bias.size} SNRs)"
    return Judgement(text, AGREES if ratio < limit else DIFFERS, sensitive or ratio >= limit)


def falls_by_20_db(result: StudyResult, reading: str) -> Judgement:
    """Judge whether the displacement jitter is significantly lower at 20 dB than at 0 dB."""
    curve = paper_curves(result, reading)[0]
    jitter, se = in_units(curve, "amplitude_jitter")
    k = int(np.argmin(np.abs(curve.x - 20)))
    text = ", ".join(with_error(jitter[index], se[index]) for index in (0, k, -1))
    text = f"displacement jitter {text} nm at 0, 20, {curve.x[-1]:g} dB"
    fall, margin = jitter[0] - jitter[k], SIGNIFICANT * math.hypot(se[0], se[k])
    level = abs(fall) + margin < LEVEL * jitter[0]
    return Judgement(text, AGREES if fall > margin else DIFFERS if level or fall < -margin else INCONCLUSIVE)


def hundred(result: StudyResult, reading: str) -> Judgement:
    """Judge whether the mean of 100 realisations at 20 dB has a standard error below 2 % of the amplitude."""
    curve = paper_curves(result, reading)[0]
    k = int(np.argmin(np.abs(curve.x - 20)))
    row, se = curve.rows[k], curve.values("amplitude_bias_se_m")[k] * NM
    realisations = row["draws"] * row["noise"]
    se_of_100 = se * math.sqrt(realisations / 100)
    limit = 0.02 * row["amplitude_true_m"] * NM
    # A standard deviation from n draws is known to 1/sqrt(2 n), of its value.
    margin = SIGNIFICANT * se_of_100 / math.sqrt(2 * row["draws"])
    text = f"standard error of the mean at 20 dB {se:.2g} nm from {realisations}, {se_of_100:.2g} nm from 100"
    return Judgement(text, AGREES if se_of_100 < limit else DIFFERS, abs(se_of_100 - limit) > margin)


def map_ratio(result: StudyResult, reading: str) -> Judgement:
    """Judge the normalised displacement at W_x = W_y = 2.19, stated as 0.82."""
    _, x, y, columns = _maps(result, reading)[-1]
    # The tracked amplitude is the true one plus the bias.
    truth = columns["amplitude_true_m"]
    value, se = at_width_ratio(x, y, 1 + columns["amplitude_bias_m"] / truth, columns["amplitude_bias_se_m"] / truth)
    return number(value, se, 0.82, 0.005)


@judge_factory
def phase_limit(result: StudyResult, reading: str, quantity: str) -> Judgement:
    """Judge an upper limit of 5 degrees where W_x and W_y exceed 0.5."""
    _, x, y, columns = _maps(result, reading)[-1]
    wide = (x[None, :] > 0.5) & (y[:, None] > 0.5)
    value, se = (np.abs(columns[f"{quantity}{suffix}_rad"])[wide] * DEGREES for suffix in ("", "_se"))
    return below(value, se, 5.0, " deg")


@judge_factory
def map_trend(result: StudyResult, reading: str, quantity: str, falls: bool) -> Judgement:
    """Judge a trend along W_x = W_y from first to last; in part if the quantity first changes the other way."""
    _, x, _, columns = _maps(result, reading)[-1]
    suffix, scale, unit = UNITS[quantity.split("_")[0]]
    value = np.abs(np.diagonal(columns[f"{quantity}_{suffix}"])) * scale
    se = np.diagonal(columns[f"{quantity}_se_{suffix}"]) * scale
    change = (value[-1] - value[0]) / math.hypot(se[0], se[-1]) * (-1 if falls else 1)
    # The extreme in the direction opposite to the trend must not differ from the first value.
    k = int(np.argmax(value if falls else -value))
    opposite = abs(value[k] - value[0]) / max(math.hypot(se[0], se[k]), 1e-300)
    reverses = opposite > sidak_quantile(len(x)) and k > 0
    first, last = with_error(value[0], se[0]), with_error(value[-1], se[-1])
    text = f"{QUANTITIES[quantity]} {first} to {last} {unit} along W_x = W_y"
    if reverses:
        text += f", but first to {with_error(value[k], se[k])} at W = {x[k]:.2g}"
    verdict = DIFFERS if change < -SIGNIFICANT else INCONCLUSIVE if change < SIGNIFICANT else AGREES
    return Judgement(text, IN_PART if reverses and verdict == AGREES else verdict)


@judge_factory
def difference_at(result: StudyResult, reading: str, index: int, stated: float, or_more: bool = False) -> Judgement:
    """Judge the largest difference from the lateral theory at one W_z, an index in ascending order."""
    w_z, difference, low, high = _differences(result, reading)[index]
    # "Up to and greater than" and "as high as" are read off a figure: half a step of 0.05.
    agrees = stated - 0.025 <= high and (or_more or low <= stated + 0.025)
    text = f"largest {difference:.3f} at W_z = {w_z:g}, true value between {low:.3f} and {high:.3f}"
    decided = not agrees or (or_more and low >= stated - 0.025) or high - low <= 0.1
    return Judgement(text, INCONCLUSIVE if high - low > stated else AGREES if agrees else DIFFERS, decided)


def differences_fall(result: StudyResult, reading: str) -> Judgement:
    """Judge whether the largest difference falls from the lowest to the highest W_z without a significant rise."""
    differences = _differences(result, reading)
    (*_, first_low, first_high), (*_, last_low, last_high) = differences[0], differences[-1]
    # A rise is significant if the bounds of adjacent values do not overlap.
    rises = any(later[2] > earlier[3] for earlier, later in itertools.pairwise(differences))
    falls, overlap = first_low > last_high, last_low <= first_high
    text = "largest " + ", ".join(f"{low:.2f} to {high:.2f} at {w_z:g}" for w_z, _, low, high in differences)
    decided = rises or all(later[1] < earlier[1] for earlier, later in itertools.pairwise(differences))
    return Judgement(text, (IN_PART if rises else AGREES) if falls else INCONCLUSIVE if overlap else DIFFERS, decided)


def wider_axially(result: StudyResult, reading: str) -> Judgement:
    """Judge whether axially wider beams change the mean by less than the paper's standard deviation, 3.4 %."""
    curve = paper_curves(result, reading)[0]
    ratio = 1 + curve.values("amplitude_bias_m") / curve.values("amplitude_true_m")
    jitter = curve.values("amplitude_jitter_m") / curve.values("amplitude_true_m")
    se = curve.values("amplitude_bias_se_m") / curve.values("amplitude_true_m")
    text = ", ".join(f"{r:.3f} ± {j:.3f} at {x:g}" for x, r, j in zip(curve.x, ratio, jitter, strict=True))
    low, high = bounds_of_largest(np.abs(ratio[1:] - ratio[0]), np.hypot(se[1:], se[0]))
    return Judgement(text, AGREES if high < 0.034 else DIFFERS if low > 0.034 else INCONCLUSIVE)


def phase_over_w_z(result: StudyResult, reading: str) -> Judgement:
    """Judge whether the phase jitter at W_x = W_y = 2.19 is constant to 10 % from W_z = 0.5 on."""
    jitters_deg = []
    for w_z, x, y, columns in _maps(result, reading):
        value, se = at_width_ratio(x, y, columns["phase_jitter_rad"], columns["phase_jitter_se_rad"])
        jitters_deg.append((w_z, value * DEGREES, se * DEGREES))
    text = "phase jitter " + ", ".join(f"{with_error(value, se)} deg at {w_z:g}" for w_z, value, se in jitters_deg)

    value, se = np.array([jitter for w_z, *jitter in jitters_deg if w_z >= 0.5]).T
    # The change is between two of the values; its standard error is at most that of the two least certain ones.
    change, margin = float(np.ptp(value)), sidak_quantile(len(value)) * float(np.hypot(*np.sort(se)[-2:]))
    # Ten percent of the mean counts as constant.
    limit = 0.1 * float(value.mean())
    verdict = AGREES if change + margin < limit else DIFFERS if change - margin > limit else INCONCLUSIVE
    return Judgement(text, verdict)


def at_width_ratio(x: FloatArray, y: FloatArray, *maps: FloatArray) -> tuple[float, ...]:
    """Return the value of each map (y, x) at x = y = 2.19, interpolated linearly in the logarithms of x and y."""
    log_ratio = math.log(PAPER_WIDTH_RATIO)
    rows = ([float(np.interp(log_ratio, np.log(x), row)) for row in values] for values in maps)
    return tuple(float(np.interp(log_ratio, np.log(y), row)) for row in rows)


def _maps(result: StudyResult, reading: str) -> list[tuple[float, FloatArray, FloatArray, Columns]]:
    """Return W_z, W_x, W_y and the columns (y, x) of every map of the paper's chain."""
    tables = maps(result, require_view(result, reading))
    return [(float(table.outer_values[0]), table.x, table.y, table.columns) for table in tables]


def _differences(result: StudyResult, reading: str) -> list[tuple[float, float, float, float]]:
    """Return W_z, the largest difference from the lateral theory, and the bounds of the true one, by W_z."""
    differences = []
    for w_z, x, y, columns in _maps(result, reading):
        truth = columns["amplitude_true_m"]
        difference = np.abs(lateral_average(x[None, :], y[:, None]) - 1 - columns["amplitude_bias_m"] / truth)
        bounds = bounds_of_largest(difference, columns["amplitude_bias_se_m"] / truth)
        differences.append((w_z, float(difference.max()), *bounds))
    return sorted(differences)
