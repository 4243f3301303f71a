"""The engine: numbers that hang on the case alone, adaptive stopping, and the published figures."""

from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hpe_rig.scene import SettingsError, shipped_scenes
from hpe_rig.study import engine
from hpe_rig.study.cases import Case, points_of
from hpe_rig.study.definition import Definition
from hpe_rig.study.engine import CaseRecord, _echoes, _RunningCase, run_batch
from hpe_rig.study.run import batches
from sim_backend.settings import Reflector

SNR = {"name": "SNR", "keys": {"simulation.receiver.snr_db": [10.0, 30.0]}}
OF_THE_RUN = ("seconds", "peak_memory_bytes")


def definition(**changed: Any) -> Definition:
    tables = {
        "title": "a study",
        "scene": "table-1",
        "scatterers": 20,
        "common": "all",
        "set": {"tracking.pulse_count": 40},
        "axes": [SNR],
    }
    return Definition.model_validate(tables | changed)


def cases_of(**changed: Any) -> list[Case]:
    return [point.case for point in points_of("own", definition(**changed))]


def numbers(record: CaseRecord) -> CaseRecord:
    """Return what of a record must not hang on when and where it was computed."""
    return {key: value for key, value in record.items() if key not in OF_THE_RUN}


def estimate(record: CaseRecord, estimator: str) -> dict[str, float]:
    return next(row for row in record["estimates"] if row["estimator"] == estimator)


def test_a_case_has_the_same_numbers_alone_and_in_any_company() -> None:
    amplitudes = {"name": "D_0", "keys": {"simulation.motion[0].amplitude_m": [1e-6, 2e-6]}}
    # One draw more than a block.
    cases = cases_of(axes=[SNR, amplitudes], scatterers=17, readings={"physical": ["coherent", "kasai"]})
    together = [numbers(record) for record in run_batch(cases)]
    assert numbers(run_batch(cases[1:2])[0]) == together[1]
    assert together[::-1] == [numbers(record) for record in run_batch(cases[::-1])]


def test_common_random_numbers_are_the_same_noise_at_every_level() -> None:
    quiet = {"name": "SNR", "keys": {"simulation.receiver.snr_db": [60.0, 66.0]}}
    louder, softer = run_batch(cases_of(axes=[quiet]))
    a, b = estimate(louder, "coherent"), estimate(softer, "coherent")
    # Errors so small are linear in the noise: 6 dB are a factor, to the square of 1e-3 rad of phase noise.
    factor = 10 ** (6 / 20)
    assert a["amplitude_noise_jitter_m"] / b["amplitude_noise_jitter_m"] == pytest.approx(factor, rel=1e-3)
    assert a["amplitude_speckle_jitter_m"] == pytest.approx(b["amplitude_speckle_jitter_m"], rel=1e-3)


def test_more_realisations_begin_with_the_same_ones() -> None:
    case = cases_of(scatterers=64)[0]
    # Stopped as soon as it may be, the longer study has used those of the shorter.
    stopped = run_batch([replace(case, scatterers=160, standard_error_m=1.0)])[0]
    assert stopped["draws"] == 64
    assert stopped["estimates"] == run_batch([case])[0]["estimates"]


def test_a_study_stops_at_the_wanted_standard_error_and_not_before() -> None:
    case = replace(cases_of()[1], scatterers=2000, standard_error_m=9e-9)
    found = run_batch([case])[0]
    assert 64 <= found["draws"] < 2000
    assert all(row["amplitude_bias_se_m"] <= 9e-9 for row in found["estimates"])
    before = run_batch([replace(case, scatterers=found["draws"] - 16, standard_error_m=None)])[0]
    assert any(row["amplitude_bias_se_m"] > 9e-9 for row in before["estimates"])


def test_ways_to_fewer_realisations_agree_with_the_plain_one_within_their_errors() -> None:
    plain = run_batch(cases_of(scatterers=160, common=[])[:1])
    for way in ({"common": "all"}, {"common": "all", "standard_error_m": 9e-9}):
        (found,) = run_batch(cases_of(scatterers=160, **way)[:1])
        for own, other in zip(found["estimates"], plain[0]["estimates"], strict=True):
            for name in ("amplitude_bias", "amplitude_jitter"):
                error_m = math.hypot(own[f"{name}_se_m"], other[f"{name}_se_m"])
                # Two estimators, two figures, two ways: 3.5 standard errors in 1 of 270 such tests.
                assert abs(own[f"{name}_m"] - other[f"{name}_m"]) < 3.5 * error_m


def test_draws_and_noise_of_every_block_have_random_numbers_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    seeds: list[tuple[int, ...]] = []
    seed_sequence = np.random.SeedSequence

    def watched(entropy: int, spawn_key: tuple[int, ...]) -> np.random.SeedSequence:
        seeds.append((entropy, *spawn_key))
        return seed_sequence(entropy, spawn_key=spawn_key)

    monkeypatch.setattr(np.random, "SeedSequence", watched)
    run_batch(cases_of(scatterers=48)[:1])
    assert len(seeds) == len(set(seeds)) == 3 * 3


def test_the_echo_of_the_focus_comes_earlier_in_a_gate_beyond_it() -> None:
    beyond_m = 30 / 100e6 * 1540 / 2
    gate = {"name": "gate", "keys": {"acquisition.gate_depth_m": [70e-3 + beyond_m]}}
    (case,) = cases_of(axes=[gate])
    alone = {"per_cell": 0.0, "reflectors": (Reflector(),)}
    twin = case.twin.model_copy(update={"scatterers": case.twin.scatterers.model_copy(update=alone)})
    made = _echoes([_RunningCase(replace(case, twin=twin))], 0, 1)
    # At rest, as the first pulse finds it: a cosine under an even window, 30 samples of 130 before the middle, 64.5.
    about = made.volts[0, made.echo_index[0], :70]
    np.testing.assert_allclose(about, about[::-1], rtol=0, atol=1e-5 * np.abs(about).max())


def test_without_noise_one_realisation_of_it_is_all_there_is(tmp_path: Path) -> None:
    scene = shipped_scenes()["table-1"].replace("snr_db = 40.0", "")
    (tmp_path / "silent.toml").write_text(scene, encoding="utf-8")
    amplitude = {"name": "D_0", "keys": {"simulation.motion[0].amplitude_m": [1e-6]}}
    (point,) = points_of("own", definition(scene="silent.toml", axes=[amplitude]), tmp_path)
    found = run_batch([point.case])[0]
    assert found["noise"] == 1
    row = estimate(found, "coherent")
    # Speckle alone, known from 20 draws to 16 %: 0.060 of the amplitude.
    assert row["amplitude_jitter_m"] == pytest.approx(60e-9, rel=0.5)
    assert math.isnan(row["amplitude_noise_jitter_m"])


def test_a_rigid_medium_gives_amplitude_and_phase_back() -> None:
    still = {"simulation.beams.width_ratio": [1e3, 1e3, 1e3], "simulation.motion": [MOTION]}
    case = cases_of(set={"tracking.pulse_count": 40, **still}, axes=[SNR | {"keys": {SNR_KEY: [80.0]}}])[0]
    for row in run_batch([case])[0]["estimates"]:
        assert (row["amplitude_true_m"], row["phase_true_rad"]) == (2e-6, pytest.approx(0.7))
        # At 80 dB and 40 draws: noise of 0.03 nm. The rest is the phase's spread over the band, cut by the gate.
        assert abs(row["amplitude_bias_m"]) < 0.03 * 2e-6
        assert abs(row["phase_bias_rad"]) < 1e-3


MOTION = {"frequency_hz": 200.0, "amplitude_m": 2e-6, "phase_rad": 0.7}
SNR_KEY = "simulation.receiver.snr_db"


def test_batches_hold_every_case_once_and_share_noise() -> None:
    pulses = {"name": "N_c", "keys": {"tracking.pulse_count": [20, 40]}}
    cases = cases_of(axes=[SNR, pulses], readings={"physical": ["kasai"], "literal": ["kasai"]})
    made = batches(cases)
    assert sorted(case.key for batch in made for case in batch) == sorted(case.key for case in cases)
    # Noise is drawn pulse by pulse, so what shares it has equally many.
    assert all(len({(case.noise_key, case.train.pulses) for case in batch}) == 1 for batch in made)
    assert batches(cases[::-1]) == made


def test_the_literal_reading_has_the_closed_form_s_mean() -> None:
    dense = {"tracking.pulse_count": 40, "simulation.scatterers.per_cell": 300.0}
    case = cases_of(
        set=dense, scatterers=32, readings={"literal": ["coherent"]}, axes=[SNR | {"keys": {SNR_KEY: [60.0]}}]
    )[0]
    row = estimate(run_batch([case])[0], "coherent")
    # All echoes add in phase, so motion is weighted by I: over the box of eq. (8) and (12), theory 1.
    expected = 1.0
    for excitation_m, tracking_m, side_m in ((0.17, 0.078, 1.0), (0.17, 0.078, 1.0), (1.80, 0.83, 1.0)):
        at_mm = np.linspace(-side_m / 2, side_m / 2, 20_001)
        weight = np.exp(-(at_mm**2) / 2 / tracking_m**2)
        expected *= float((weight * np.exp(-(at_mm**2) / 2 / excitation_m**2)).sum() / weight.sum())
    found = 1 + row["amplitude_bias_m"] / 1e-6
    # Three standard errors, and 1 / (scatterers in the beam) of a ratio of sums: about 600 at this density.
    assert found == pytest.approx(expected, abs=3 * row["amplitude_bias_se_m"] / 1e-6 + 1 / 600)


# Tracked over peak displacement from an earlier simulation, written apart from this one, and its standard error.
PUBLISHED = [
    ("physical", "cross_spectrum", 2.18, 0.892, 0.0018),
    ("physical", "coherent", 2.18, 0.887, 0.0013),
    ("literal", "cross_spectrum", 2.18, 0.813, 0.0005),
    ("literal", "cross_spectrum", 5.0, 0.821, 0.0005),
    ("literal", "cross_spectrum", 10.0, 0.823, 0.0005),
]


@pytest.mark.slow
@pytest.mark.parametrize(("reading", "estimator", "ratio_z", "expected", "error"), PUBLISHED)
def test_the_tracked_part_of_the_peak_is_the_published_one(
    reading: str, estimator: str, ratio_z: float, expected: float, error: float
) -> None:
    ratios = {"simulation.beams.width_ratio": [0.17 / 0.078, 0.17 / 0.078, ratio_z]}
    case = cases_of(
        set={"tracking.pulse_count": 100, **ratios},
        scatterers=2000,
        readings={reading: [estimator]},
        axes=[SNR | {"keys": {SNR_KEY: [60.0]}}],
    )[0]
    row = estimate(run_batch([case])[0], estimator)
    allowed = 3 * math.hypot(row["amplitude_bias_se_m"] / 1e-6, error)
    assert 1 + row["amplitude_bias_m"] / 1e-6 == pytest.approx(expected, abs=allowed)
    if reading == "literal" and ratio_z == 2.18:
        # The scatter of a draw, 0.024: 2000 draws know theirs to 1.6 %, and two digits are given.
        assert row["amplitude_speckle_jitter_m"] / 1e-6 == pytest.approx(0.024, abs=0.0025)


def test_readings_that_share_estimates_share_their_time(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s, estimated = 0.0, engine.states

    def a_second_each(*args: Any) -> Any:
        nonlocal now_s
        now_s += 1.0
        return estimated(*args)

    monkeypatch.setattr(engine, "states", a_second_each)
    monkeypatch.setattr(engine.time, "process_time", lambda: now_s)
    readings = {"literal": ["cross_spectrum", "coherent"], "as_printed": ["cross_spectrum"]}
    axis = SNR | {"keys": {SNR_KEY: [30.0]}}
    literal, as_printed = run_batch(cases_of(scatterers=2, axes=[axis], readings=readings))
    # of the two estimates one is for both
    assert literal["seconds"] == 3 * as_printed["seconds"] > 0


def test_as_printed_keeps_the_gain_of_the_difference_and_one_draw_has_the_noise_of_one_draw_alone() -> None:
    readings = {name: ["cross_spectrum"] for name in ("physical", "literal", "as_printed", "one_draw")}
    rate = {"tracking.pulse_rate_hz": 1000.0, "tracking.pulse_count": 25}
    cases = cases_of(
        set=rate, scatterers=8, noise=3, readings=readings, axes=[SNR | {"keys": {SNR_KEY: [30.0]}}], common="all"
    )
    rows = [estimate(record, "cross_spectrum") for record in run_batch_of_each(cases)]
    literal_m, printed_m = (row["amplitude_true_m"] + row["amplitude_bias_m"] for row in rows[1:3])
    assert printed_m / literal_m == pytest.approx(np.sinc(200 / 1000), rel=1e-12)
    assert rows[2]["phase_bias_rad"] == pytest.approx(rows[1]["phase_bias_rad"], abs=1e-12)
    assert (cases[3].scatterers, cases[3].noise) == (1, 24)
    # Physical: 8 draws with their speckle; one draw: noise alone, of 24 realisations that are independent.
    assert rows[3]["amplitude_jitter_m"] < 0.5 * rows[0]["amplitude_jitter_m"]
    expected = rows[3]["amplitude_jitter_m"] / np.sqrt(23)
    assert rows[3]["amplitude_bias_se_m"] == pytest.approx(expected, rel=1e-9)


def test_an_estimator_without_a_difference_has_no_gain_to_leave_in() -> None:
    with pytest.raises(SettingsError, match="the amplitude of coherent has no gain of a difference of pulses"):
        cases_of(readings={"as_printed": ["coherent"]})


def run_batch_of_each(cases: list[Case]) -> list[CaseRecord]:
    return [run_batch([case])[0] for case in cases]


def test_the_peak_of_a_worker_is_its_own() -> None:
    large = np.ones(25_000_000)
    say = "from hpe_rig.study.engine import peak_memory_bytes; print(peak_memory_bytes())"
    worker = subprocess.run([sys.executable, "-c", say], capture_output=True, text=True, check=True)
    # What it imports takes about 50 MB.
    assert 20e6 < int(worker.stdout) < 150e6 < large.nbytes <= engine.peak_memory_bytes()
