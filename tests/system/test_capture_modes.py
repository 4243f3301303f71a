"""The ways to capture and the second channel, as a bench file chooses them: what they give, where they are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from hpe_rig.bench import read_bench
from hpe_rig.measurement.run import record_run
from hpe_rig.measurement.setup import prepare, prepare_text
from hpe_rig.plan.checks.check_result import PlanError
from hpe_rig.scene import shipped_scenes
from hpe_rig.store import RunWriter, read_run

TABLE_1 = shipped_scenes()["table-1"]
MODES = ("single_port", "traditional", "npt")
MONITOR_V = 0.2
# Nothing is connected to channel B of the twin: zero volts, which lies between two codes of 14 bits.
HALF_A_CODE_V = 0.5 * MONITOR_V / 8191.5 * (1 + 1e-6)


def bench(folder: Path, *lines: str) -> Path:
    path = folder / "bench.toml"
    path.write_text(read_bench().text.replace("[digitizer]", "\n".join(["[digitizer]", *lines])), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def echoes(tmp_path_factory: pytest.TempPathFactory) -> np.ndarray:
    """Return the echoes of a run with the shipped bench file."""
    run = read_run(record_run(prepare("table-1"), tmp_path_factory.mktemp("shipped") / "run.h5"))
    assert run.records.monitor(0) is None
    return run.records[0].codes


@pytest.mark.parametrize(
    "mode", [pytest.param(mode, marks=() if mode == "npt" else pytest.mark.slow) for mode in MODES]
)
def test_every_way_to_capture_gives_the_same_echoes_with_a_second_channel(
    tmp_path: Path, echoes: np.ndarray, mode: str
) -> None:
    lines = f'acquisition_mode = "{mode}"', f"monitor_range_v = {MONITOR_V}"
    run = read_run(record_run(prepare("table-1", bench(tmp_path, *lines)), tmp_path / "run.h5"))
    np.testing.assert_array_equal(run.records[0].codes, echoes)
    # NPT records carry no header, so no trigger time.
    assert np.isnan(run.records[0].trigger_time_s).all() == (mode == "npt")
    monitor = run.records.monitor(0)
    assert monitor is not None
    assert np.max(np.abs(monitor.codes * monitor.volts_per_code + monitor.volts_offset)) <= HALF_A_CODE_V
    setup = prepare("table-1", bench(tmp_path, *lines))
    with RunWriter(tmp_path / "next.h5", setup.scene, setup.bench, setup.plan) as writer:
        writer.copy_shot(run, 0)
    taken_over = read_run(tmp_path / "next.h5").records.monitor(0)
    assert taken_over is not None
    np.testing.assert_array_equal(taken_over.codes, monitor.codes)
    # Whatever way: xarray sees the second channel beside the first.
    with xr.open_dataset(run.path, group="records", engine="h5netcdf") as records:
        assert records["monitor"].dims == records["echo"].dims == ("shot", "pulse", "sample")
        assert records["monitor"].attrs["units"] == "V"
        assert float(np.abs(records["monitor"]).max()) <= HALF_A_CODE_V
        assert float(np.abs(records["echo"]).max()) > 0.01


@pytest.mark.parametrize(
    ("lines", "edit", "words"),
    [
        (
            ['acquisition_mode = "npt"'],
            ("[acquisition]", "[acquisition]\nrecord_samples = 2032"),
            ["NPT", "2016 or 2048"],
        ),
        (["monitor_range_v = 0.3"], ("", ""), ["monitor_range_v = 0.3 is none of"]),
        (
            ["monitor_range_v = 0.2"],
            ("[acquisition]", "[acquisition]\nrecord_samples = 1048576"),
            ["record_samples of 2 channels = 1048576", "1048552"],
        ),
    ],
)
def test_what_the_board_cannot_capture_is_refused_with_the_plan(
    tmp_path: Path, lines: list[str], edit: tuple[str, str], words: list[str]
) -> None:
    with pytest.raises(PlanError) as raised:
        prepare_text("edited", TABLE_1.replace(*edit), bench(tmp_path, *lines))
    (line,) = [text for text in str(raised.value).splitlines() if text.strip().startswith("capture mode:")]
    assert all(word in line for word in [*words, "Try:"]), line


@pytest.mark.parametrize("mode", ["traditional", "npt"])
def test_a_board_without_dual_port_memory_cannot_stream(tmp_path: Path, mode: str) -> None:
    text = read_bench().text.replace("dual_port_memory = true", f'acquisition_mode = "{mode}"')
    path = tmp_path / "bench.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(PlanError, match=f"acquisition_mode = {mode}.*needs dual-port memory.*single_port"):
        prepare("table-1", path)
