"""Verdicts on statements of the paper: agreement, difference, inconclusive and missing studies."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import dblquad

from hpe_rig.study.definition import Definition, shipped_studies
from hpe_rig.study.map_figures import lateral_average
from hpe_rig.study.results import StudyResult
from hpe_rig.study.series import with_error
from hpe_rig.validation.paper import claims as claim_judges, judgement, reproduction
from hpe_rig.validation.paper.judgement import AGREES, DIFFERS, IN_PART, INCONCLUSIVE, NOT_RUN

Values = Callable[[dict[str, float]], dict[str, float]]
SNR_DB = [0.0, 20.0, 40.0]
COLUMNS = [
    f"{name}_{part}_{unit}" for name, unit in (("amplitude", "m"), ("phase", "rad")) for part in ("bias", "jitter")
]


def result(axes: dict[str, list[float]], values: Values, readings: tuple[str, ...] = ("physical",)) -> StudyResult:
    """Return a study of prescribed values; missing values are 0 with a standard error of 1 nm or mrad."""
    definition = Definition.model_validate(
        {
            "title": "prescribed",
            "scene": "table-1",
            "readings": {name: ["cross_spectrum"] for name in readings},
            "axes": [{"name": name, "keys": {f"key.{name}": list(axis_values)}} for name, axis_values in axes.items()],
        }
    )
    rows = []
    for reading in readings:
        for point in itertools.product(*axes.values()):
            at = dict(zip(axes, point, strict=True))
            row: dict[str, Any] = {**at, "reading": reading, "estimator": "cross_spectrum", "frequency_hz": 200.0}
            row |= {"amplitude_true_m": 1e-6, "phase_true_rad": 0.0, "draws": 500, "noise": 2}
            for name in COLUMNS:
                quantity, _, unit = name.rpartition("_")
                row |= {name: 0.0, f"{quantity}_se_{unit}": 1e-9 if unit == "m" else 1e-3}
            rows.append({**row, **values(at)})
    return StudyResult("prescribed", definition, rows, ("0",))


def curves(jitter_nm: Callable[[float, float], float]) -> StudyResult:
    """Return two curves over SNR, parameter 0 and 1, of displacement jitter with a standard error of 1 nm."""
    return result(
        {"P": [0.0, 1.0], "SNR": SNR_DB}, lambda at: {"amplitude_jitter_m": jitter_nm(at["P"], at["SNR"]) * 1e-9}
    )


@pytest.mark.parametrize(
    ("jitter_nm", "verdict"),
    [
        (lambda p, snr: 100 - 20 * p, AGREES),
        (lambda p, snr: 100 + 20 * p, DIFFERS),
        (lambda p, snr: 100 - 2 * p, INCONCLUSIVE),
        (lambda p, snr: 100 - 20 * p if snr < 30 else 100 + 20 * p, IN_PART),
        (lambda p, snr: 100 - 20 * p if snr < 10 else 100 + 2 * p, IN_PART),
        (lambda p, snr: 1000 - 2 * p, DIFFERS),
    ],
)
def test_a_trend_agrees_where_it_is_significant_at_0_20_and_40_db_and_a_level_quantity_has_none(
    jitter_nm: Callable[[float, float], float], verdict: str
) -> None:
    assert judgement.trend("amplitude_jitter", falls=True)(curves(jitter_nm), "physical").verdict == verdict


def test_no_effect_means_small_or_within_chance_at_every_snr() -> None:
    judge = judgement.flat("amplitude_jitter", 10.0)
    assert judge(curves(lambda p, snr: 100 + 9 * p), "physical").verdict == AGREES
    assert judge(curves(lambda p, snr: 100 + (30 if snr == 0 else 1) * p), "physical").verdict == IN_PART
    assert judge(curves(lambda p, snr: 100 + 30 * p), "physical").verdict == DIFFERS


def test_a_number_agrees_within_its_rounding_and_three_errors() -> None:
    assert judgement.number(0.8150, 0.001, 0.818, 0.0005).verdict == AGREES
    assert judgement.number(0.8150, 0.001, 0.819, 0.0005).verdict == DIFFERS
    assert with_error(0.81453, 0.00123) == "0.8145 ± 0.0012"
    assert with_error(0.0123, 4e-8) == "0.0123 ± 4e-08"


def test_few_draws_that_agree_with_any_number_do_not_decide() -> None:
    assert judgement.number(0.8150, 0.001, 0.816, 0.0005).decided
    few = judgement.number(0.80, 0.05, 0.816, 0.0005)
    assert (few.verdict, few.text) == (AGREES, "agrees, not decided")
    # No further draws make a number agree that lies this far off.
    assert judgement.number(0.50, 0.05, 0.816, 0.0005).text == DIFFERS


@pytest.mark.parametrize(
    ("jitter_nm", "text"),
    [
        (lambda p, snr: 100 - 20 * p, AGREES),
        (lambda p, snr: 100 - (20 if snr < 10 else 2) * p, "in part, not decided"),
        (lambda p, snr: 100 + (20 if snr < 10 else 2) * p, "differs, not decided"),
        # Falls, rises, unclear: in part whatever the third one is.
        (lambda p, snr: 100 + {0: -20, 20: 20, 40: 2}[int(snr)] * p, IN_PART),
    ],
)
def test_a_trend_is_decided_if_no_unclear_snr_could_change_it(
    jitter_nm: Callable[[float, float], float], text: str
) -> None:
    judged = judgement.trend("amplitude_jitter", falls=True)(curves(jitter_nm), "physical")
    assert judged.text == text
    # Two values with a standard error of 1 nm differ by a value with one of sqrt(2) nm.
    assert "± 1.4" in judged.finding


def test_the_headline_counts_the_verdicts_that_more_draws_could_change() -> None:
    def section(jitter_se_m: float) -> str:
        study = result({"SNR": SNR_DB}, lambda at: {"amplitude_bias_m": -185e-9, "amplitude_jitter_m": 34e-9})
        rows = [row | {"amplitude_jitter_se_m": jitter_se_m} for row in study.rows]
        part = reproduction.reproduction_part([replace(study, name="fig-4", rows=rows)])
        assert part is not None
        return part.headline

    assert "do not decide" not in section(0.1e-9)
    few = re.search(r"500 draws do not decide (\d) of these 7 verdicts; --draws 2000", section(10e-9))
    assert few is not None
    assert int(few[1]) > 1


def test_a_limit_for_the_largest_of_many_values_allows_for_selection() -> None:
    one = np.ones(1)
    assert judgement.below(1.9 * one, one, 5.0, "").verdict == AGREES
    assert judgement.below(4.9 * one, one, 5.0, "").verdict == INCONCLUSIVE
    assert judgement.below(8.5 * one, one, 5.0, "").verdict == DIFFERS
    assert judgement.below(np.full(121, 8.5), np.ones(121), 5.0, "").verdict == INCONCLUSIVE
    assert judgement.sidak_quantile(1) == pytest.approx(3.0, abs=1e-9)
    # Of 121 independent values the largest exceeds it as rarely as one exceeds three: to 0.0027 +- 3 sqrt(0.0027 / n).
    draws = np.abs(np.random.default_rng(1).standard_normal((20_000, 121))).max(axis=1)
    rare = 2 * 0.001349898
    assert np.mean(draws > judgement.sidak_quantile(121)) == pytest.approx(rare, abs=3 * np.sqrt(rare / 20_000))


def test_no_effect_is_inconclusive_if_noise_could_hide_one() -> None:
    assert judgement.flat("amplitude_jitter", 1.0)(curves(lambda p, snr: 100.0), "physical").verdict == INCONCLUSIVE


def test_the_lateral_theory_is_the_mean_motion_under_the_squared_beam() -> None:
    def integral(motion: float) -> float:
        def weighted(y: float, x: float) -> float:
            return float(np.exp(-(x**2) * (1 + motion / (2 * 2.19**2)) - y**2 * (1 + motion / (2 * 0.7**2))))

        return float(dblquad(weighted, -8, 8, -8, 8)[0])

    assert lateral_average(np.array(2.19), np.array(0.7)) == pytest.approx(integral(1.0) / integral(0.0), rel=1e-7)
    assert lateral_average(np.array(2.19), np.array(2.19)) == pytest.approx(0.9056, abs=5e-5)


def test_a_map_is_read_between_its_points_linearly_in_the_logarithms() -> None:
    x = np.geomspace(0.1, 10, 11)
    values = 2 * np.log(x)[None, :] + 3 * np.log(x)[:, None] + 1
    assert claim_judges.at_width_ratio(x, x, values) == pytest.approx([5 * np.log(2.19) + 1], rel=1e-12)


def test_differences_from_the_lateral_theory_are_judged_by_w_z() -> None:
    w = np.geomspace(0.1, 10, 11).tolist()

    def values(at: dict[str, float]) -> dict[str, float]:
        theory = float(lateral_average(np.array(at["W_x"]), np.array(at["W_y"])))
        return {"amplitude_bias_m": (theory - 1 - 0.1 / at["W_z"] * (at["W_x"] > 5)) * 1e-6}

    study = result({"W_z": [0.2, 0.4, 1.0], "W_x": w, "W_y": w}, values)
    assert claim_judges.differences_fall(study, "physical").verdict == AGREES
    first, last = claim_judges.difference_at(0, 0.3, or_more=True), claim_judges.difference_at(-1, 0.3)
    assert first(study, "physical").verdict == AGREES  # "up to and above"
    assert last(study, "physical").verdict == DIFFERS
    assert last(study, "physical").finding == "largest 0.100 at W_z = 1, true value between 0.096 and 0.104"


def test_every_reading_is_judged_by_its_rows_and_missing_studies_are_named() -> None:
    study = result(
        {"SNR": SNR_DB}, lambda at: {"amplitude_bias_m": -185e-9, "amplitude_jitter_m": 34e-9}, ("physical",)
    )
    rows = {row["the paper"]: row for row in reproduction.rows({"fig-4": study})}
    assert rows["error at high SNR 18.5 %"]["verdict, physical"] == AGREES
    assert rows["error at high SNR 18.5 %"]["verdict, literal"] == NOT_RUN
    assert rows["phase jitter decreases as N_c increases"]["verdict, physical"] == NOT_RUN
    assert not any(row["why"] for row in rows.values() if row["verdict, physical"] == AGREES)


def test_a_difference_is_shown_with_its_reason() -> None:
    study = result({"SNR": SNR_DB}, lambda at: {"amplitude_bias_m": -110e-9, "amplitude_jitter_m": 80e-9})
    row = reproduction.rows({"fig-4": study})[0]
    assert row["verdict, physical"] == DIFFERS
    assert row["physical"] == "11.00 ± 0.10 %"
    assert row["why"].startswith("physical: scatterers at different depths")


def test_the_study_of_every_statement_is_shipped() -> None:
    assert {claim.study for claim in reproduction.CLAIMS} <= set(shipped_studies())
