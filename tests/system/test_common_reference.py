"""A generator that must be locked to the 10 MHz reference is refused if it is not, before and after a shot."""

from __future__ import annotations

from pathlib import Path

import pytest

import hpe_rig as hpe
from drivers.interfaces import InstrumentError

CLOCKS = "simulation.instruments.clock_error"
LOCKED = {"generators.burst_train": '"source"', "generators.tracking_train": "true"}


def bench_with(tmp_path: Path, keys: dict[str, str]) -> Path:
    """Return the simulated bench with ``common_reference`` in each table of ``keys``."""
    from importlib import resources

    text = (resources.files("hpe_rig.bench") / "shipped" / "simulated.toml").read_text(encoding="utf-8")
    for table, value in keys.items():
        text = text.replace(f"[{table}]", f"[{table}]\ncommon_reference = {value}")
    path = tmp_path / "bench.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_locked_generators_leave_no_rate_error(tmp_path: Path) -> None:
    changes = {f"{CLOCKS}.tracking_train": 0.0, f"{CLOCKS}.burst_train": 0.0, "excitation.burst_count": 10}
    scene = hpe.load_scene("free-running-clocks").with_(changes)
    run = hpe.measure(scene, bench=bench_with(tmp_path, LOCKED), path=tmp_path / "run.h5")
    (shot,) = run.estimate().shots
    assert shot.frequency_error is None


def test_a_generator_that_is_not_locked_ends_the_run_with_outputs_off(tmp_path: Path) -> None:
    scene = hpe.load_scene("free-running-clocks").with_({"excitation.burst_count": 10})
    with pytest.raises(InstrumentError, match="tracking_train: its clock is not locked to the 10 MHz input"):
        hpe.measure(scene, bench=bench_with(tmp_path, LOCKED), path=tmp_path / "run.h5")


def test_a_board_cannot_be_locked(tmp_path: Path) -> None:
    from hpe_rig.bench import read_bench
    from hpe_rig.scene import SettingsError

    with pytest.raises(SettingsError, match="cannot lock an ATS460 to a 10 MHz reference"):
        read_bench(bench_with(tmp_path, {"digitizer": "true"}))
