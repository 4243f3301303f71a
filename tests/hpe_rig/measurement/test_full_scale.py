"""A first shot at full scale in every record ends the run; its records are kept."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from drivers.interfaces import InstrumentError, RecordBlock
from hpe_rig.cli.app import app
from hpe_rig.measurement import prepare
from hpe_rig.measurement.run import end_at_full_scale, record_run
from hpe_rig.measurement.sequencer import Event, ShotBlock, ShotDone
from hpe_rig.runs import open_run
from hpe_rig.scene import scene_text
from hpe_rig.store import read_run

SCENE = scene_text("table-1")[1]


def scene(folder: Path, echo_rms_v: float) -> Path:
    """Return the path of a scene of two shots with echoes of ``echo_rms_v`` in the range of the digitizer."""
    path = folder / "scene.toml"
    text = SCENE.replace("[acquisition]\n", "[acquisition]\nrepeats = 2\ninput_range_v = 0.2\n")
    text = text.replace("snr_db = 40.0", f"snr_db = 40.0\necho_rms_v = {echo_rms_v}")
    path.write_text(text, encoding="utf-8")
    return path


def test_full_scale_in_every_record_of_the_first_shot_ends_the_run_with_its_records(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    with pytest.raises(InstrumentError, match=r"all \d+ records of shot 1 reach full scale \(\+-0\.2 V\)") as error:
        record_run(prepare(scene(tmp_path, 5.0)), path)
    assert "hpe-rig resume" in str(error.value)
    run = read_run(path)
    assert (run.status, run.shot_complete.tolist()) == ("failed", [False, False])
    assert run.records[0].valid.all()


def test_some_records_at_full_scale_do_not_end_the_run(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    text = scene_text("bovine-muscle")[1].replace("[acquisition]", "[acquisition]\ninput_range_v = 0.2")
    path.write_text(text, encoding="utf-8")
    run = read_run(record_run(prepare(path), tmp_path / "run.h5"))
    assert (run.status, run.clipped) == ("complete", (0,))


@pytest.mark.parametrize("end", [-128, 127])
def test_full_scale_at_either_end_counts_and_only_in_the_gate(end: int) -> None:
    shot = prepare("table-1").plan.shots[0]
    codes = np.zeros((4, shot.capture.record_samples), np.int16)
    blocks = [ShotBlock(shot, RecordBlock(first, codes, np.zeros(4), 1.0, 0.0, (-128, 127))) for first in (0, 4)]

    def run() -> list[Event]:
        return list(end_at_full_scale(event for event in (*blocks, ShotDone(shot, False))))

    codes[:, shot.gate.start - 1] = end
    assert len(run()) == 3
    codes[:, shot.gate.start] = end
    with pytest.raises(InstrumentError, match="all 8 records of shot 1 reach full scale"):
        run()
    codes[3, shot.gate] = 0
    assert len(run()) == 3


def test_the_command_says_what_to_change(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["run", str(scene(tmp_path, 5.0)), "--output", str(tmp_path / "run.h5")])
    assert result.exit_code == 1
    assert "a new run with a larger acquisition.input_range_v" in result.output
    assert "holds the records that had arrived" in result.output
    # The value of clipped echoes is printed, but not as a result.
    (shot,) = open_run(tmp_path / "run.h5").estimate().shots
    assert "every record" in shot.untrusted
    printed = CliRunner().invoke(app, ["process", str(tmp_path / "run.h5")]).output
    assert printed.lstrip().startswith("NOT TO BE TRUSTED: ")
