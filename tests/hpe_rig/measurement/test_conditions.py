"""A shot waits with outputs off until the conditions of the bench are within their limits; its readings are stored."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from typer.testing import CliRunner

from drivers.interfaces import InstrumentError
from hpe_rig.bench import Condition, open_bench, parse_bench, read_bench
from hpe_rig.cli.app import app
from hpe_rig.measurement import Progress, Setup, Step, acquire, prepare_resumption, prepare_text, record_run, resume
from hpe_rig.measurement.between_shots import wait_for_conditions
from hpe_rig.runs import json_schema, open_run
from hpe_rig.scene import shipped_scenes
from hpe_rig.store import list_runs, read_run

# Two tonebursts and 16 pulses on prescribed motion.
SHORT = (
    ("burst_count = 20", "burst_count = 2"),
    ("pulse_rate_hz = 4000.0", "pulse_rate_hz = 1000.0"),
    ("delay_s = 130e-6", "delay_s = 130e-6\npulse_count = 16"),
    ("window_start_s = 50e-3", 'estimator = "kasai"\nfrequencies_hz = [100.0] #'),
    ("[simulation.specimen]", "[[simulation.motion]]\nfrequency_hz = 100.0\namplitude_m = 1e-6 #"),
    ('preset = "bovine_muscle" ', "#"),
    ("force_density_n_per_m3 = 2.2e6 ", "#"),
    ("[simulation.receiver]", "[simulation.scatterers]\nper_cell = 0.05\n[simulation.receiver]"),
    ("[acquisition]\n", "[acquisition]\nrepeats = 2\n"),
)


class Thermometer:
    """A file with the temperature, and the condition that reads it."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "temperature.txt"
        self.show("20.5")

    def show(self, text: str) -> None:
        self.path.write_text(text, encoding="utf-8")

    @property
    def keys(self) -> str:
        program = "import pathlib, sys; print(pathlib.Path(sys.argv[1]).read_text())"
        command = json.dumps([sys.executable, "-S", "-c", program, str(self.path)])
        return f'\n[[conditions]]\nname = "temperature"\nunit = "degC"\ncommand = {command}\nmin = 19.0\nmax = 22.0\n'

    @property
    def condition(self) -> Condition:
        return parse_bench("bench", read_bench().text + self.keys).bench.conditions[0]


@pytest.fixture
def thermometer(tmp_path: Path) -> Thermometer:
    return Thermometer(tmp_path)


@pytest.fixture
def setup(thermometer: Thermometer) -> Setup:
    """Return two short shots on a bench with a thermometer and a sensor that fails."""
    text = shipped_scenes()["bovine-muscle-synchronous"]
    for old, new in SHORT:
        assert old in text, old
        text = text.replace(old, new)
    failing = '\n[[conditions]]\nname = "level"\nunit = "mm"\ncommand = ["no-such-program-here"]\n'
    bench = thermometer.path.parent / "bench.toml"
    bench.write_text(read_bench().text + thermometer.keys + failing, encoding="utf-8")
    return prepare_text("short", text, bench)


class Time:
    """A clock that each sleep advances, and then calls ``then``."""

    def __init__(self, then: Callable[[float], None] = lambda now_s: None) -> None:
        self.now_s, self._then = 0.0, then

    def sleep(self, duration_s: float) -> None:
        self.now_s += duration_s
        self._then(self.now_s)

    def clock(self) -> float:
        return self.now_s


def test_a_wait_ends_when_the_condition_is_back_and_says_both(
    thermometer: Thermometer, caplog: pytest.LogCaptureFixture
) -> None:
    thermometer.show("25")
    time, watched = Time(lambda now_s: thermometer.show("21") if now_s > 3.0 else None), list[int]()
    values = wait_for_conditions([thermometer.condition], 3, lambda: watched.append(1), time.sleep, time.clock)
    assert values == (21.0,)
    assert 3.0 < time.now_s < 6.0
    assert len(watched) > 10
    begin, end = (record.getMessage() for record in caplog.records if record.levelno == logging.WARNING)
    assert begin.startswith("paused before shot 3, all outputs are off: temperature 25 degC, limits 19 to 22 degC")
    assert end == "continuing with shot 3: temperature 21 degC, limits 19 to 22 degC"


@pytest.mark.parametrize("text", ["25", "no number"])
def test_a_condition_that_stays_outside_its_limits_ends_the_run_after_the_longest_wait(
    thermometer: Thermometer, text: str
) -> None:
    thermometer.show(text)
    time, condition = Time(), thermometer.condition.model_copy(update={"max_wait_s": 10.0})
    with pytest.raises(InstrumentError, match=r"not within the limits for 1\d s before shot 1: temperature .*resume"):
        wait_for_conditions([condition], 1, lambda: None, time.sleep, time.clock)
    assert 10.0 <= time.now_s < 13.0


def test_without_conditions_nothing_is_watched_or_read() -> None:
    assert wait_for_conditions([], 1, lambda: pytest.fail("watched")) == ()


def test_every_output_is_off_while_conditions_are_read(setup: Setup) -> None:
    steps = list[Step]()
    with open_bench(setup.scene.scene, setup.bench.bench, setup.plan.roles) as bench:

        def observe(progress: Progress) -> None:
            steps.append(progress.step)
            if progress.step is Step.CONDITIONS:
                assert not any(item.snapshot()["output_on"] for item in bench.generators)

        for _ in acquire(setup.plan, bench, observe, conditions=setup.bench.bench.conditions):
            pass
    assert steps.count(Step.CONDITIONS) == 2


def test_readings_are_stored_and_shown_wherever_the_run_is(
    setup: Setup, thermometer: Thermometer, tmp_path: Path
) -> None:
    def warm_up(progress: Progress) -> None:
        if progress.step is Step.FIRE:
            thermometer.show("22.5" if progress.shot.index else "21.5")

    path = record_run(setup, tmp_path / "run.h5", warm_up)
    stored = read_run(path)
    np.testing.assert_array_equal(stored.conditions["temperature"], [[20.5, 21.5], [21.5, 22.5]])
    assert np.isnan(stored.conditions["level"]).all()
    result = open_run(path).estimate()
    temperature, level = result.conditions
    assert (temperature.lowest, temperature.highest, temperature.mean, level.not_read) == (20.5, 22.5, 21.5, 4)
    assert result.shots[1].conditions["temperature"] == (21.5, 22.5)
    assert "temperature was 22.5 degC after shot 2, limits 19 to 22 degC" in result.warnings
    assert any(text.startswith("level was not read 4 times") for text in result.warnings)
    row = result.to_frame().iloc[0]
    assert (row.condition_temperature_before, row.condition_temperature_after) == (20.5, 21.5)
    assert result.to_xarray().condition_temperature.values.tolist() == [21.0, 22.0]
    jsonschema.validate(json.loads(json.dumps(result.as_dict())), json_schema("result"))
    (entry,) = list_runs(tmp_path)[0]
    assert entry.conditions == {"temperature degC": 21.5}
    jsonschema.validate([json.loads(json.dumps(entry.as_dict()))], json_schema("list"))
    for command in (("process", str(path)), ("list", str(tmp_path))):
        output = " ".join(CliRunner().invoke(app, command).output.split())
        assert "temperature" in output


def test_a_resumed_run_has_the_conditions_of_the_shots_that_it_copies(
    setup: Setup, thermometer: Thermometer, tmp_path: Path
) -> None:
    def stop(progress: Progress) -> None:
        if progress.shot.index == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record_run(setup, tmp_path / "run.h5", stop)
    thermometer.show("21.0")
    resumption = prepare_resumption(tmp_path / "run.h5", bench_path=tmp_path / "bench.toml")
    resumed = read_run(resume(resumption, tmp_path / "resumed.h5"))
    np.testing.assert_array_equal(resumed.conditions["temperature"], [[20.5, 20.5], [21.0, 21.0]])


def test_a_run_without_conditions_reads_and_stores_none(setup: Setup, tmp_path: Path) -> None:
    steps = list[Step]()
    bench = replace(setup.bench, bench=setup.bench.bench.model_copy(update={"conditions": ()}))
    path = record_run(replace(setup, bench=bench), tmp_path / "run.h5", lambda progress: steps.append(progress.step))
    assert Step.CONDITIONS not in steps
    assert not read_run(path).conditions
    assert not open_run(path).estimate().conditions
