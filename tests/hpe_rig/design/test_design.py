"""The designer finds what closed forms say is best, within limits that hold, and says all that is wrong at once."""

from __future__ import annotations

import math
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from hpe_rig.bench import read_bench
from hpe_rig.cli.app import app
from hpe_rig.design.command import Request, write_design
from hpe_rig.design.comparison import _Outcome, _unconfirmed_gains, compare
from hpe_rig.design.model import effective_pulses, predicted
from hpe_rig.design.page import write_page
from hpe_rig.design.problem import Goal, Problem
from hpe_rig.design.search import DesignResult, find_design
from hpe_rig.design.simulation_check import simulate
from hpe_rig.design.variables import variables
from hpe_rig.measurement.setup import Setup, prepare, prepare_text
from hpe_rig.prediction import EstimatorErrors, time_base_text, time_base_uncertainty
from hpe_rig.result import symbols
from hpe_rig.scene import SettingsError, scene_text
from hpe_rig.study import Errors

# Everything moves alike and by little: hardly any speckle jitter, and the noise is the Cramer-Rao bound's.
NO_SPECKLE = scene_text("table-1")[1].replace("[0.17e-3, 0.17e-3, 1.80e-3]", "[1.0, 1.0, 1.0]")
NO_SPECKLE = NO_SPECKLE.replace("amplitude_m = 1000e-9", "amplitude_m = 20e-9")

HIGH_HARMONIC = """
title = "3 kHz, pushed by tonebursts"
[excitation]
burst_rate_hz = 100.0
burst_length_s = 100e-6
burst_count = 4
[tracking]
pulse_rate_hz = 8000.0
disturbed = "keep"
[acquisition]
gate_depth_m = 20.0e-3
[beams]
excitation_width_m = [1.0, 1.0, 1.0]
tracking_width_m = [0.078e-3, 0.078e-3, 0.83e-3]
pulse_length_m = 1.32e-3
[processing]
estimator = "cross_spectrum"
frequencies_hz = [3000.0]
expected_snr_db = 20.0
expected_amplitude_m = 1e-7
[simulation]
seed = 1
[simulation.beams]
focus_depth_m = 20.0e-3
"""


def _problem(
    setup: Setup, over: str, goal: Goal, *bounds: str, longest_s: float | None = None, target_m: float | None = None
) -> Problem:
    longest_s = longest_s or setup.plan.duration_s
    tables = tomllib.loads(setup.scene.text)
    space = variables(tables, setup.scene.scene, setup.bench.bench, longest_s, over.split(","), bounds)
    return Problem(setup, tables, space, goal, longest_s=longest_s, target_m=target_m)


def _best(found: DesignResult) -> dict[str, float]:
    return {".".join(map(str, path)): value for path, value in found.best.values.items()}


@pytest.fixture(scope="module")
def most_pulses() -> DesignResult:
    setup = prepare_text("no-speckle", NO_SPECKLE)
    return find_design(_problem(setup, "pulse_rate_hz,pulse_count", "jitter", longest_s=0.02), generations=2)


def test_noise_falls_with_the_pulses_so_as_many_as_time_and_depth_allow_are_best(most_pulses: DesignResult) -> None:
    best = _best(most_pulses)
    rate_hz, count = best["tracking.pulse_rate_hz"], best["tracking.pulse_count"]
    # The echo of 70 mm and its record must be over before the next pulse: below c/2z, nearer than 3 %.
    limit_hz = 1540 / (2 * 70.5e-3)
    assert 0.97 * limit_hz < rate_hz < limit_hz
    assert 0.02 * rate_hz - 1 <= count <= 0.02 * rate_hz
    # Phase variance 1 / (130 SNR) of one echo, 2 / count of it in each quadrature.
    bound_m = 1540.0 / (4 * np.pi * 9e6) * np.sqrt(2 / (int(count) * 130 * 1e4))
    # Rice at 20 nm 0.1 %, pulses that are no whole cycles 1 %, the band's share of a speckle's echo 1 %
    assert most_pulses.best.predict(50, 0).noise_jitter_m == pytest.approx(float(bound_m), rel=0.02)


def test_the_page_says_before_and_after_and_draws_the_goal_over_each_number(
    most_pulses: DesignResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    comparison = compare(most_pulses)
    path = write_page(most_pulses, comparison, "my scenes/mine.toml", "hpe-rig design mine.toml", lambda *_: None)
    page = path.read_text(encoding="utf-8")
    assert path.name == "mine-design.html"
    before, after = next(row[1:] for row in comparison.outcome_rows() if row[0] == "jitter over amplitude")
    assert f"Jitter over amplitude: {after} instead of {before}." in page
    assert page.count("<figure") == len(most_pulses.problem.space)
    for name, _, now in (*comparison.varied_rows(), *comparison.outcome_rows()):
        assert symbols(name) in page
        assert f">{symbols(now)}<" in page
    assert "<script" not in page


def test_what_holds_the_best_scene_back_is_said(most_pulses: DesignResult) -> None:
    words = " ".join(most_pulses.limits)
    assert "record in period" in words
    assert "more tracking.pulse_count: time" in words


def test_places_are_moved_to_where_the_moduli_are_told_best() -> None:
    setup = prepare("gelatin-moduli")
    short = {"excitation.burst_count": 8, "processing.window_start_s": 20e-3}
    setup = prepare(setup.scene.scene.with_({**short, "sweep.lateral_offset_m": [1e-3, 1.5e-3]}))
    place = "sweep.lateral_offset_m[1]"
    problem = _problem(setup, place, "modulus-uncertainty", f"{place}=0.0012:0.006")
    grid = np.linspace(0.0, 1.0, 5)
    cost = [problem.cost(problem.values_at(np.array([each]))) for each in grid]
    # two places that hardly differ tell little of the medium; what they tell is the bound that check prints
    assert cost[0] > cost[2] + 0.5
    best = problem.candidate(problem.values_at(np.array([grid[int(np.argmin(cost))]])))
    mu1 = best.moduli.uncertainty[0] / best.moduli.values[0]
    assert min(cost) == pytest.approx(math.log(mu1), abs=1e-4)
    assert mu1 < problem.start.moduli.uncertainty[0] / problem.start.moduli.values[0]


def test_moduli_need_a_push_to_be_designed_for() -> None:
    with pytest.raises(SettingsError, match="nothing pushes"):
        write_design(Request("table-1", "gate_length_m", "modulus-uncertainty"), print, print, print)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_design() -> None:
    setup = prepare_text("no-speckle", NO_SPECKLE)
    first, again = (find_design(_problem(setup, "gate_length_m", "phase-jitter"), 7, generations=1) for _ in range(2))
    assert again.best.values == first.best.values
    assert again.problem.evaluations == first.problem.evaluations


def test_the_toneburst_that_moves_a_harmonic_most_is_half_its_period() -> None:
    found = find_design(_problem(prepare_text("high", HIGH_HARMONIC), "burst_length_s", "phase-jitter"), generations=2)
    # eq. (18): the harmonic n goes with sin(pi n f_r T_b); one cycle of 3 MHz is the step
    assert _best(found)["excitation.burst_length_s"] == pytest.approx(1 / 6000, abs=1.01 / 3e6)
    assert found.best.setting is not None
    gain = 1 / math.sin(math.pi * 3000 * 100e-6)
    assert found.best.setting.amplitude_m == pytest.approx(1e-7 * gain, rel=1e-4)


def test_the_dose_holds_the_toneburst_back() -> None:
    setup = prepare_text("low", HIGH_HARMONIC.replace("[3000.0]", "[100.0]"))
    calibration = setup.bench.bench.calibration
    assert calibration is not None
    assert calibration.toneburst is not None
    loud = calibration.toneburst.model_copy(update={"sppa_w_per_m2": 1.5e6})
    file = setup.bench.bench.model_copy(update={"calibration": calibration.model_copy(update={"toneburst": loud})})
    setup = replace(setup, bench=replace(setup.bench, bench=file))
    found = find_design(_problem(setup, "burst_length_s", "jitter"), generations=2)
    # 0.3 dB/cm/MHz over 7 cm: 6.3 dB at 3 MHz, 18.9 dB at 9 MHz
    tracking = 3.2e3 * 10**-1.89 * 3 / 9e6 * 8000
    allowed_s = (7.2e3 - tracking) / (1.5e6 * 10**-0.63 * 100)
    assert _best(found)["excitation.burst_length_s"] == pytest.approx(math.floor(allowed_s * 3e6) / 3e6, rel=1e-9)
    assert "more excitation.burst_length_s: acoustic output" in found.limits


def test_the_shortest_scene_keeps_the_target() -> None:
    setup = prepare_text("no-speckle", NO_SPECKLE)
    target_m = 1e-9
    found = find_design(_problem(setup, "pulse_count", "time", longest_s=0.2, target_m=target_m), generations=2)
    # N = 2 (metres per radian / target)^2 / (samples SNR), of the bound
    needed = 2 * (1540 / (4 * math.pi * 9e6) / target_m) ** 2 / (129.87 * 1e4)
    # whole cycles of 20 pulses tell amplitudes best: within one; 1 % of speckle jitter is 2 % of the pulses
    assert _best(found)["tracking.pulse_count"] == pytest.approx(needed, abs=20)
    assert found.best.expected.jitter_m <= target_m


@pytest.mark.slow
def test_no_scene_of_a_grid_is_better_than_the_design() -> None:
    setup = prepare("bovine-muscle-synchronous", refuse=False)
    problem = _problem(setup, "pulse_rate_hz,tracking.delay_s", "phase-jitter", longest_s=0.202)
    found = find_design(problem, 1)
    rate, delay = problem.space
    grid = [
        {rate.key.path: rate.value(place), delay.key.path: delay.value(share)}
        for place in range(int(rate.last) + 1)
        for share in np.linspace(0, 1, 40)
    ]
    assert len(grid) > 1000
    # numbers that gain less than 1e-4 stay as the scene has them
    assert problem.cost(found.best.values) <= min(map(problem.cost, grid)) + 1e-4


def test_a_number_that_does_not_matter_stays_as_it_is() -> None:
    setup = prepare_text("no-speckle", NO_SPECKLE)
    found = find_design(_problem(setup, "pulse_count,input_range_v", "jitter", longest_s=0.05), generations=2)
    assert set(_best(found)) == {"tracking.pulse_count"}


def test_a_target_out_of_reach_says_what_can_be_reached() -> None:
    problem = _problem(prepare_text("no-speckle", NO_SPECKLE), "pulse_count", "time", target_m=1e-12)
    with pytest.raises(SettingsError, match=r"smallest jitter is 1\.[67].*above the 0\.001 nm"):
        find_design(problem, generations=1)


def test_no_scene_within_the_limits_names_the_conflict() -> None:
    problem = _problem(prepare_text("no-speckle", NO_SPECKLE), "pulse_rate_hz", "jitter", "pulse_rate_hz=2e4:3e4")
    with pytest.raises(SettingsError, match="depth: no candidate passes"):
        find_design(problem, generations=1)


def test_every_mistake_is_named_at_once(tmp_path: Path) -> None:
    taken = tmp_path / "taken.toml"
    taken.touch()
    request = Request(
        scene="bovine-muscle",
        over="pulserate,carrier_hz,excitation_width_m,shot_period_s",
        minimise="speed",
        bounds=("gate_length_m=1e-3:2e-3", "cycles=5:2"),
        longest_s=-1.0,
        target="3 feet",
        draws=1,
        seed=-1,
        output=taken,
    )
    with pytest.raises(SettingsError) as caught:
        write_design(request, print, print, print)
    named = [mistake.path for mistake in caught.value.mistakes]
    assert named == [
        *("--minimise", "--longest-s", "--draws", "--seed", "--output", "--target"),
        *("pulserate", "carrier_hz", "excitation_width_m"),
        *("--bound gate_length_m=1e-3:2e-3", "--bound cycles=5:2", "acquisition.shot_period_s"),
    ]
    assert "tracking.pulse_rate_hz" in str(caught.value)


@pytest.mark.parametrize("bound", ["sample_rate_hz=1.1e8:1.2e8", "record_samples=513:520", "cycles=2.5:3.5"])
def test_bounds_without_two_values_are_refused(bound: str) -> None:
    setup = prepare_text("no-speckle", NO_SPECKLE)
    with pytest.raises(SettingsError, match="no two values to choose from"):
        _problem(setup, bound.partition("=")[0], "jitter", bound)


def test_what_the_bench_takes_in_steps_is_varied_in_steps() -> None:
    setup = prepare("bovine-muscle-synchronous", refuse=False)
    keys = "pulse_rate_hz,sample_rate_hz,record_samples,burst_length_s,cycles,gate_length_m"
    space = _problem(setup, keys, "jitter").space
    rate, sampling, record, burst, cycles, gate = (
        [variable.value(place) for place in np.linspace(0, variable.last, 7)] for variable in space
    )
    assert not np.mod(rate, 100.0).any()
    assert set(sampling) == {20e6, 50e6, 100e6, 125e6}
    assert not np.mod(record, 16).any()
    np.testing.assert_allclose(np.array(burst) * 3e6, np.round(np.array(burst) * 3e6), atol=1e-6)
    assert all(isinstance(value, int) for value in cycles)
    # c / f to the whole record of 512 samples
    assert 1540 / 9e6 <= gate[0] < gate[-1] <= 512 / 100e6 * 770
    for variable in space:
        assert variable.position(variable.value(variable.last)) == pytest.approx(variable.last)


def test_what_the_model_lacks_is_named_at_once() -> None:
    bare = NO_SPECKLE.replace("snr_db = 40.0", "").replace("[beams]", "[medium]").replace("excitation_width_m", "#")
    bare = bare.replace("tracking_width_m", "#").replace("pulse_length_m", "#").replace("[medium]", "")
    setup = prepare_text("bare", bare)
    with pytest.raises(SettingsError) as caught:
        _problem(setup, "pulse_count", "jitter")
    assert [mistake.path for mistake in caught.value.mistakes] == ["beams", "processing.expected_snr_db"]


@pytest.mark.parametrize("gate_m", [pytest.param(1e-3, marks=pytest.mark.slow), 3e-3])
def test_noise_of_a_longer_gate_is_predicted_from_the_echo_left_in_it(gate_m: float) -> None:
    setup = prepare_text("gate", NO_SPECKLE.replace("gate_length_m = 1.0e-3", f"gate_length_m = {gate_m}"))
    problem = _problem(setup, "pulse_count", "jitter")
    start = replace(problem.start, values={})
    assert start.setting is not None
    assert start.scene is not None
    assert start.plan is not None
    draws = 96
    simulated = simulate(start.scene, start.plan, start.setting, problem.baseline, draws, 3)
    assert simulated is not None
    amplitude, _ = simulated
    # the model's 15 %, and three standard errors of a standard deviation
    assert amplitude.jitter == pytest.approx(start.predict(50, 0).jitter_m, rel=0.15 + 3 / math.sqrt(2 * draws))
    # Faded echoes make heavy tails: an excess kurtosis k raises the normal error by sqrt(1 + k / 2), at 3 mm to 1.54.
    assert 0.5 < amplitude.jitter_se / (amplitude.jitter / math.sqrt(2 * draws)) < 1.7


def test_few_draws_predict_the_papers_chain_like_many_at_a_high_pulse_rate() -> None:
    text = NO_SPECKLE.replace("gate_length_m = 1.0e-3", "gate_length_m = 3.0e-3").replace("4000.0", "10600.0")
    setting = _problem(prepare_text("fast", text), "pulse_count", "jitter").start.setting
    assert setting is not None
    many = predicted(setting, "cross_spectrum", 2000, 10).noise_jitter_m
    # the variance is the covariance v of steps 2 v: 200 draws know it to sqrt(5 / 200) = 16 %, its root to 8 %, three
    few = [predicted(setting, "cross_spectrum", 200, seed).noise_jitter_m for seed in range(4)]
    np.testing.assert_allclose(few, many, rtol=0.24)


def test_pulses_are_worth_what_the_fit_makes_of_them() -> None:
    setup = prepare("bovine-muscle", refuse=False)
    scene, shot = setup.scene.scene, setup.plan.shots[0]
    bare = scene.model_copy(update={"excitation": None})
    time_s = shot.timeline.pulse_onset_s
    time_s = time_s[time_s - time_s[0] >= 50e-3 - 1e-4]
    frequencies_hz = 100.0 * np.arange(1, 11)
    angle = 2 * np.pi * np.outer(time_s, frequencies_hz)
    matrix = np.hstack([np.sin(angle), np.cos(angle), np.ones((time_s.size, 1))])
    plan = replace(setup.plan, shots=(replace(shot, timeline=replace(shot.timeline, burst_onset_s=np.zeros(0))),))
    own = bare.model_copy(
        update={"processing": scene.processing.model_copy(update={"frequencies_hz": tuple(frequencies_hz)})}
    )
    variance = np.linalg.inv(matrix.T @ matrix).diagonal()[[0, 10]]
    assert effective_pulses(own, plan) == round(2 / variance.mean())
    # a gap after every toneburst leaves a hundred free harmonics hard to tell apart; a prior of media holds them
    free = scene.model_copy(update={"processing": scene.processing.model_copy(update={"harmonic": "least_squares"})})
    assert effective_pulses(free, setup.plan) < 0.1 * time_s.size
    assert effective_pulses(scene, setup.plan) > 0.7 * time_s.size


def test_the_command_writes_a_scene_that_check_passes(tmp_path: Path) -> None:
    output, bench = tmp_path / "better.toml", tmp_path / "bench.toml"
    bench.write_text(read_bench(None).text, encoding="utf-8")
    words = ["design", "table-1", "--over", "pulse_count", "--longest-s", "0.03", "--draws", "32"]
    words += ["--bound", "pulse_count=40:60", "--bench", str(bench)]
    result = CliRunner().invoke(app, [*words, "--output", str(output)])
    assert result.exit_code == 0, result.output
    assert "jitter, simulated" in result.output
    assert "pulse_length_m = 1.32e-3    # 1.71 us" in output.read_text(encoding="utf-8")
    assert prepare(str(output)).plan.duration_s <= 0.03
    assert result.output.endswith(f"hpe-rig check {output} --bench {bench}\n")
    assert f" --bench {bench} " in output.read_text(encoding="utf-8").splitlines()[0]


def test_without_a_better_scene_none_is_written_or_suggested(tmp_path: Path) -> None:
    output, shown = tmp_path / "better.toml", list[str]()
    request = Request(scene="table-1", over="pulse_count", bounds=("pulse_count=99:101",), draws=0, output=output)
    write_design(request, shown.append, print, print)
    assert "no scene within the limits is better than the starting scene" in shown[0]
    assert shown[-1] == f"{output}: not written, table-1 stays the best scene"
    assert not output.exists()


def test_a_predicted_gain_that_the_simulation_lacks_is_said() -> None:
    def outcome(predicted_m: float, simulated_m: float) -> _Outcome:
        prediction = EstimatorErrors("coherent", 0.0, predicted_m, predicted_m, 0.0, 1e-3)
        amplitude, phase = (
            Errors(0.0, 0.1 * jitter, jitter, jitter_se, jitter, jitter_se, 0.0, 0.0)
            for jitter, jitter_se in ((simulated_m, 0.3e-9), (1e-3, 1e-4))
        )
        return _Outcome({}, prediction, (amplitude, phase))

    before = outcome(5.2e-9, 5.1e-9)
    (text,) = _unconfirmed_gains(before, outcome(3.2e-9, 5.0e-9))
    assert text.startswith("the simulation does not confirm the gain in jitter: it falls by 0.1 +- 0.42 nm")
    assert not list(_unconfirmed_gains(before, outcome(3.2e-9, 3.3e-9)))


def test_the_phase_has_the_u_of_the_clocks_that_check_predicts() -> None:
    setup = prepare("free-running-clocks")
    problem = _problem(setup, "pulse_rate_hz", "phase-jitter")
    start = problem.judged(problem.start)
    scene, shot = setup.scene.scene, setup.plan.shots[0]
    *_, phase_u = time_base_uncertainty(scene, setup.bench.bench, shot)
    assert start.clock_phase_u == pytest.approx(phase_u[0], rel=1e-12)
    assert phase_u[0] > 1e-5
    noise_rad = start.expected.phase_jitter_rad
    assert problem.measure(start) == pytest.approx(math.log(math.hypot(noise_rad, phase_u[0])), rel=1e-4)
    outcome = {name: text for name, text, _ in compare(DesignResult(problem, start, start, ())).outcome_rows()}
    # check prints 'add u of the phase of 0.0054 deg at 100 Hz' for this scene.
    (line,) = time_base_text(scene, setup.bench.bench, shot)
    assert f"{float(outcome['time base, phase'].split()[0]):.2g} deg at 100 Hz" in line


def test_one_clock_or_a_linear_drift_has_no_row_of_the_clocks() -> None:
    drifting = prepare("free-running-clocks", changes={"processing.drift": "linear"})
    for setup in (prepare("bovine-muscle"), drifting):
        problem = _problem(setup, "pulse_rate_hz", "phase-jitter")
        start = problem.judged(problem.start)
        assert start.clock_phase_u == 0
        assert "clock_phase_u_rad" not in compare(DesignResult(problem, start, start, ())).after
