"""Every output of the program is written by one atomic writer: no link is followed, no earlier file is lost."""

from __future__ import annotations

import errno
import os
import shutil
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from typer.testing import CliRunner

import hpe_rig.report.page as report_page
from hpe_rig.cli.app import app
from hpe_rig.cli.stored import write_map
from hpe_rig.measurement.log import run_log
from hpe_rig.measurement.queue import QueueRun, write_queue
from hpe_rig.measurement.requests import write_request, write_stop
from hpe_rig.measurement.setup import prepare
from hpe_rig.result import MotionMap
from hpe_rig.store import StoreError, replace_text, write_marks
from hpe_rig.study.definition import Definition
from hpe_rig.study.results import FIELDS, CaseStore, StudyResult, write_study
from hpe_rig.validation.accuracy.work_precision import save_figure, write_rows

AXES = [{"name": "D_0", "keys": {"simulation.motion[0].amplitude_m": [1e-6]}}]
FIXTURES = Path(__file__).parents[1] / "fixtures" / "run_files"
posix = pytest.mark.skipif(os.name != "posix", reason="links and pipes of POSIX")


def motion_map() -> MotionMap:
    """Return a map of 2 lines and 3 depths."""
    pixels, estimates = np.full((2, 3), 1e-6), np.full((2, 3, 1), 1e-6)
    return MotionMap(
        line_m=np.arange(2.0), depth_m=np.arange(3.0), frequency_hz=np.array([200.0]), amplitude_m=estimates,
        amplitude_uncertainty_m=estimates, phase_rad=estimates, phase_uncertainty_rad=estimates,
        velocity_m_per_s=pixels, velocity_uncertainty_m_per_s=pixels, residual_m=pixels, power=pixels,
        bad=np.zeros((2, 3), np.uint8), origin="a test", lines_are_placed=False,
    )  # fmt: skip


def command(*arguments: object) -> None:
    """Run a command of the program in this process; raise ``StoreError`` with its message if it ends with code 2."""
    done = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if done.exit_code == 2:
        raise StoreError(done.output)
    assert done.exit_code == 0, done.output


def study() -> StudyResult:
    """Return a study of one row."""
    definition = Definition.model_validate({"title": "t", "scene": "table-1", "axes": AXES})
    return StudyResult("s", definition, [{"case": "c", "seconds": 1.0}], ("1",))


OUTPUTS: dict[str, Callable[[Path], Any]] = {
    "run.html": lambda path: command("report", path.with_suffix(".h5"), "--output", path),
    "run.coherent.h5": lambda path: command("process", path.with_name("run.h5"), "--estimator", "coherent"),
    "map.nc": lambda path: write_map(motion_map(), path, None),
    "map.png": lambda path: write_map(motion_map(), None, path),
    "map.svg": lambda path: write_map(motion_map(), None, path),
    "rows.csv": lambda path: write_rows([{"a": 1}], path, None, lambda rows, figure: None, str),
    "curve.pdf": lambda path: save_figure(Figure(), path),
    "queue.json": lambda path: write_queue(path.parent, [QueueRun("a", "", None, "01-a.h5")]),
    "study.json": lambda path: write_study(study(), path.parent),
    "summary.csv": lambda path: write_study(study(), path.parent),
    "ab/abc.json": lambda path: CaseStore(path.parents[1]).write(dict.fromkeys(FIELDS, 0) | {"case": "abc"}),
    "run.marks.json": lambda path: write_marks(path.with_name("run.h5"), {"run_id": ""}, {0: "bad"}),
    "run.h5.stop": lambda path: write_stop(path.with_suffix(""), "0"),
    "run.h5.pause": lambda path: write_request(path, "0"),
}
"""Function that writes each output, by its name."""
REFUSED_LINKS = ("run.html", "run.coherent.h5")
"""Outputs that replace only a file of their kind."""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with a run file and a file of somebody else outside of it."""
    (tmp_path / "victim").write_bytes(b"of somebody else")
    (tmp_path / "out").mkdir()
    shutil.copy(FIXTURES / "specimen.h5", tmp_path / "out" / "run.h5")
    monkeypatch.setattr(MotionMap, "figure", lambda _: Figure())
    monkeypatch.setattr(report_page, "render", lambda *_, **__: "<!DOCTYPE html>new")
    return tmp_path / "out"


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@posix
@pytest.mark.parametrize("name", [name for name in OUTPUTS if name not in REFUSED_LINKS])
def test_an_output_replaces_a_planted_link_and_leaves_its_target(name: str, folder: Path) -> None:
    (folder / name).parent.mkdir(exist_ok=True)
    (folder / name).symlink_to(folder.parent / "victim")
    OUTPUTS[name](folder / name)
    assert not (folder / name).is_symlink()
    assert (folder / name).stat().st_size
    assert (folder.parent / "victim").read_bytes() == b"of somebody else"


@posix
@pytest.mark.parametrize("name", REFUSED_LINKS)
def test_an_output_that_only_replaces_its_kind_refuses_a_link_to_another_file(name: str, folder: Path) -> None:
    (folder / name).symlink_to(folder.parent / "victim")
    with pytest.raises(StoreError, match="exists and is n"):
        OUTPUTS[name](folder / name)
    assert (folder.parent / "victim").read_bytes() == b"of somebody else"


@pytest.mark.parametrize("call", ["fsync", "replace"])
@pytest.mark.parametrize("name", OUTPUTS)
def test_an_output_on_a_failing_disk_ends_in_a_message_and_the_earlier_file_stays(
    name: str, call: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / name).parent.mkdir(exist_ok=True)
    OUTPUTS[name](folder / name)
    before = contents(folder)

    def fail(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, call, fail)
    with pytest.raises((StoreError, OSError), match=r"cannot be written|No space left"):
        OUTPUTS[name](folder / name)
    assert contents(folder) == before


@posix
def test_bench_file_behind_a_link_of_its_own_is_replaced_whole_or_not_at_all(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = folder / "bench.toml"
    bench.write_text("before")
    calls = list[str]()
    monkeypatch.setattr(os, "fsync", lambda number: calls.append("folder" if _is_folder(number) else "file"))
    real = os.replace
    monkeypatch.setattr(os, "replace", lambda *paths: (calls.append("rename"), real(*paths)))
    replace_text(bench, "after")
    assert bench.read_text() == "after"
    assert calls == ["file", "rename", "folder"]


def _is_folder(number: int) -> bool:
    return stat.S_ISDIR(os.fstat(number).st_mode)


@posix
@pytest.mark.parametrize("planted", ["link", "second name", "pipe"])
def test_a_log_is_refused_where_a_link_or_pipe_is_planted(planted: str, folder: Path) -> None:
    log, victim = folder / "run.log", folder.parent / "victim"
    if planted == "link":
        log.symlink_to(victim)
    elif planted == "second name":
        log.hardlink_to(victim)
    else:
        os.mkfifo(log)
    refused = pytest.raises(StoreError, match=r"run.log cannot be written \(it is a link or no ordinary file\).*Try")
    with refused, run_log(prepare("table-1"), folder / "run.h5"):
        pytest.fail("the log was opened")
    assert victim.read_bytes() == b"of somebody else"
