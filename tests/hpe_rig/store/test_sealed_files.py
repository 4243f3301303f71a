"""Files with a checksum beside run and result files: ``verify`` knows them, and one changed bit is never read."""

from __future__ import annotations

import json
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray

from hpe_rig.measurement import QueueRun, read_queue
from hpe_rig.measurement.queue import QUEUE_COPY, write_queue
from hpe_rig.result import MotionMap
from hpe_rig.store import StoreError, sealed_json, verify, write_map, write_marks
from hpe_rig.study.definition import Definition
from hpe_rig.study.results import StudyResult, write_study

RUNS = tuple(
    QueueRun(f"a-{n}", 'title = "µ"\nburst_count = 6\n', "/b.toml", f"0{n}-a.h5", planned_s=1.25) for n in (1, 2)
)
AXIS = {"name": "D_0", "keys": {"simulation.motion[0].amplitude_m": [1e-6]}}


def write_study_of_one_row(folder: Path) -> None:
    definition = Definition.model_validate({"title": "t", "scene": "table-1", "axes": [AXIS]})
    row = {"D_0": 1e-6, "case": "c", "seconds": 1.0}
    write_study(StudyResult("s", definition, [row], ("1",)), folder)


def write_small_map(path: Path) -> None:
    pixels, estimates = np.full((2, 3), 1e-6), np.full((2, 3, 1), 1e-6)
    motion_map = MotionMap(
        line_m=np.arange(2.0), depth_m=np.arange(3.0), frequency_hz=np.array([200.0]), amplitude_m=estimates,
        amplitude_uncertainty_m=estimates, phase_rad=estimates, phase_uncertainty_rad=estimates,
        velocity_m_per_s=pixels, velocity_uncertainty_m_per_s=pixels, residual_m=pixels, power=pixels,
        bad=np.zeros((2, 3), np.uint8), origin="a test", lines_are_placed=False,
    )  # fmt: skip
    write_map(path, motion_map.to_xarray())


def json_values(path: Path) -> Any:
    return json.loads(path.read_bytes())


def map_values(path: Path) -> Any:
    with xarray.open_dataset(path, engine="h5netcdf") as dataset:
        return dataset.to_dict()


FILES: dict[str, tuple[Callable[[Path], Any], Callable[[Path], Any]]] = {
    "queue.json": (lambda path: write_queue(path.parent, RUNS), json_values),
    "study.json": (lambda path: write_study_of_one_row(path.parent), json_values),
    "summary.csv": (lambda path: write_study_of_one_row(path.parent), Path.read_bytes),
    "run.marks.json": (lambda path: write_marks(path.with_name("run.h5"), {"run_id": "1"}, {0: "bad"}), json_values),
    "map.nc": (lambda path: write_small_map(path), map_values),
}
"""Writer of each file, and a reader of its values, by name."""


@pytest.mark.parametrize("bits", [10, pytest.param(50, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", FILES)
def test_verify_finds_every_changed_bit_that_changes_a_value(name: str, tmp_path: Path, bits: int) -> None:
    write, values = FILES[name]
    path = tmp_path / name
    write(path)
    whole, before = verify(path), values(path)
    assert whole.as_dict()["sound"], whole
    data = path.read_bytes()
    for bit in random.Random(1).sample(range(8 * len(data)), bits):
        changed = bytearray(data)
        changed[bit // 8] ^= 1 << bit % 8
        path.write_bytes(changed)
        try:
            damaged = not verify(path).as_dict()["sound"]
        except StoreError:
            damaged = True
        assert damaged or repr(values(path)) == repr(before), f"bit {bit}"


@pytest.mark.parametrize("text", ["{}", '{"format": "another program"}', '{"format": 7}'])
def test_verify_names_the_files_that_it_knows(text: str, tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(StoreError, match=r"no file of hpe-rig with a checksum. Try: queue, marks, study, summary"):
        verify(tmp_path / "a.json")


def test_every_changed_bit_of_a_queue_is_refused_or_harmless(tmp_path: Path) -> None:
    write_queue(tmp_path, RUNS)
    (tmp_path / QUEUE_COPY).unlink()
    path = tmp_path / "queue.json"
    data = path.read_bytes()
    refused = 0
    for bit in range(0, 8 * len(data), 13):
        changed = bytearray(data)
        changed[bit // 8] ^= 1 << bit % 8
        path.write_bytes(changed)
        try:
            assert read_queue(tmp_path) == RUNS
        except StoreError:
            refused += 1
    # Nearly every bit is part of a value or of the notation.
    assert refused > len(data) / 2


@pytest.mark.parametrize("name", ["../../escaped.h5", "/a.h5", "sub/a.h5", r"..\a.h5", "C:a.h5", "..", "a.toml", ""])
def test_a_queue_writes_no_file_outside_its_folder(name: str, tmp_path: Path) -> None:
    run = {"name": "a", "scene_toml": "", "bench": None, "run_file": name}
    (tmp_path / "queue.json").write_text(sealed_json({"format": "hpe_rig queue", "runs": [run]}))
    with pytest.raises(StoreError, match=r"the run file .* (is no plain name|does not end in .h5)"):
        read_queue(tmp_path)


@pytest.mark.parametrize("content", [b"", b'{"format": "hpe_rig qu', None])
def test_a_queue_with_a_damaged_list_goes_on_from_its_copy_and_says_so(content: bytes | None, tmp_path: Path) -> None:
    write_queue(tmp_path, RUNS)
    path = tmp_path / "queue.json"
    path.unlink() if content is None else path.write_bytes(content)
    reports = list[str]()
    assert read_queue(tmp_path, reports.append) == RUNS
    assert len(reports) == 1
    assert "queue.json cannot be read" in reports[0]
    assert QUEUE_COPY in reports[0]
