"""Checks of the fit and of the twin's echo: what passes can be estimated, what is refused could not be."""

from __future__ import annotations

import re
from collections.abc import Mapping

import pytest

from hpe_rig.bench import read_bench
from hpe_rig.plan.checks.check_result import CheckResult
from hpe_rig.plan.checks.checklist import check_plan
from hpe_rig.plan.selection import select
from hpe_rig.plan.shots import make_plan
from hpe_rig.processing.harmonics.model import linear_model
from hpe_rig.scene import load_scene

BENCH = read_bench().bench
SHORT = {"processing.window_start_s": 0.05, "processing.window_length_s": 0.012}
CONDITION = re.compile(r"\(condition (\S+), limit")
EXACT_CONDITION = 1e6
"""Up to here the fit's message is exact: it takes the condition from products, which hold half of the 16 digits."""


def found_of(changes: Mapping[str, object], name: str = "bovine-muscle") -> dict[str, CheckResult]:
    own = load_scene(name).with_(changes)
    return {found.check: found for found in check_plan(own, BENCH, make_plan(own, BENCH))}


def levels(changes: Mapping[str, object]) -> dict[str, str]:
    return {check: found.level for check, found in found_of(changes).items()}


@pytest.mark.parametrize(
    "order", [0, 8, 20, *(pytest.param(order, marks=pytest.mark.slow) for order in (2, 4, 6, 10, 12, 14, 16, 18))]
)
@pytest.mark.parametrize("length_s", [0.012, 0.03, pytest.param(0.1, marks=pytest.mark.slow)])
def test_a_background_is_refused_where_least_squares_would_refuse_it(order: int, length_s: float) -> None:
    changes = SHORT | {"processing.window_length_s": length_s, "processing.background_order": order}
    changes |= {"processing.harmonic": "least_squares"}
    own = load_scene("bovine-muscle").with_(changes)
    chosen = select(own, make_plan(own, BENCH).shots[0])
    try:
        linear_model(chosen.time_s, chosen.used, chosen.wanted_hz, background_order=order)
        refusal = ""
    except ValueError as error:
        refusal = str(error)
    found = found_of(changes)
    assert ("fit" in found) == bool(refusal)
    stated = [CONDITION.search(text) for text in (refusal, found["fit"].text if refusal else "")]
    if stated[0] and float(stated[0][1]) < EXACT_CONDITION:
        # Three digits, of a background in other units of time.
        assert stated[1] is not None
        assert float(stated[1][1]) == pytest.approx(float(stated[0][1]), rel=0.02)


def test_an_estimator_without_prior_needs_what_least_squares_need() -> None:
    changes = SHORT | {"processing.background_order": 20}
    assert levels(changes | {"processing.estimator": "cross_spectrum"})["fit"] == "refused"
    assert "fit" not in levels(changes)


def test_a_window_after_the_train_is_refused_by_its_start() -> None:
    window = found_of({"excitation.burst_count": 6, "processing.window_start_s": 0.1}, "gelatin-moduli")["window"]
    assert window.level == "refused"
    assert "window_start_s = 0.1 s lies after the end of the tracking train" in window.text
    # A window that starts in the train and ends after it has the other message.
    window = found_of(
        {"excitation.burst_count": 6, "processing.window_start_s": 0.03, "processing.window_length_s": 1.0}
    )
    assert "in a tracking train of" in window["window"].text


def test_more_unknowns_than_pulses_are_refused() -> None:
    changes = {"processing.window_length_s": 0.005, "processing.background_order": 5}
    assert levels(changes | {"processing.harmonic": "least_squares"})["fit"] == "refused"


@pytest.mark.parametrize(("snr_db", "level"), [(-40.0, "refused"), (-1.0, "warning"), (20.0, None)])
def test_an_echo_below_its_noise_is_told(snr_db: float, level: str | None) -> None:
    found = found_of({"simulation.receiver.snr_db": snr_db}).get("echo in noise")
    assert (found and found.level) == level


def test_a_fit_larger_than_memory_is_refused() -> None:
    many = {"tracking.pulse_count": 1_000_000, "processing.window_start_s": 0.05}
    assert levels(many)["fit size"] == "refused"
    assert "fit size" not in levels(many | {"processing.window_length_s": 20.0})


@pytest.mark.parametrize(("bandwidth", "refused"), [(1e-4, True), (1e-3, False)])
def test_an_echo_longer_than_the_time_between_pulses_is_refused(bandwidth: float, refused: bool) -> None:
    found = levels({"simulation.scatterers.bandwidth": bandwidth})
    assert (found.get("echo length") == "refused") == refused
