"""Long recordings stay in their file and give the same run file."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import hpe_rig as hpe
from hpe_rig.recordings import arrays, read_recording, read_settings

RF = np.random.default_rng(4).normal(size=(2, 3, 40, 160)).astype(np.float32)
SETTINGS: dict[str, Any] = {"axes": "line,shot,pulse,sample", "sample_rate_hz": 50e6, "pulse_rate_hz": 4e3}
SETTINGS |= {"carrier_hz": 9e6, "line_pitch_m": 1e-4, "lines": "all"}


def npy(path: Path, rf: Any) -> dict[str, Any]:
    np.save(path, rf)
    return {}


def fortran_npy(path: Path, rf: Any) -> dict[str, Any]:
    np.save(path, np.asfortranarray(rf))
    return {}


def raw(path: Path, rf: Any) -> dict[str, Any]:
    path.write_bytes(b"header" + rf.astype(">f4").tobytes())
    return {"dtype": "float32", "byte_order": "big", "shape": rf.shape, "header_bytes": 6}


def hdf5(path: Path, rf: Any) -> dict[str, Any]:
    with h5py.File(path, "w") as file:
        file["rf"] = rf
    return {}


def hdf5_behind_a_user_block(path: Path, rf: Any) -> dict[str, Any]:
    with h5py.File(path, "w", userblock_size=512) as file:
        file["rf"] = rf
    return {}


def hdf5_in_chunks(path: Path, rf: Any) -> dict[str, Any]:
    with h5py.File(path, "w") as file:
        file.create_dataset("rf", data=rf, compression="gzip")
    return {}


FORMATS: list[tuple[Callable[[Path, Any], dict[str, Any]], str, bool]] = [
    (npy, "a.npy", True),
    (fortran_npy, "a.npy", True),
    (raw, "a.raw", True),
    (hdf5, "a.h5", True),
    (hdf5_behind_a_user_block, "a.h5", True),
    (hdf5_in_chunks, "a.h5", False),
]


@pytest.mark.parametrize(("write", "name", "is_mapped"), FORMATS)
def test_values_in_their_file_are_those_in_memory(
    write: Callable[[Path, Any], dict[str, Any]],
    name: str,
    is_mapped: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    stated, origins = read_settings(None, None, SETTINGS | write(tmp_path / name, RF))
    in_memory = read_recording(tmp_path / name, stated, origins)
    monkeypatch.setattr(arrays, "MIN_MAPPED_BYTES", 1)
    recording = read_recording(tmp_path / name, stated, origins)
    np.testing.assert_array_equal(recording.values, RF)
    np.testing.assert_array_equal(in_memory.values, RF)
    assert recording.sha256 == in_memory.sha256 == hashlib.sha256((tmp_path / name).read_bytes()).hexdigest()
    base = recording.values
    while base is not None and not isinstance(base, np.memmap):
        base = base.base  # type: ignore[assignment]
    assert (base is not None) == is_mapped


def test_a_mapped_recording_gives_the_run_file_of_one_in_memory(
    scene_of_gate: Callable[[float, float, float], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = scene_of_gate(1.2e-3, 0.5e-3, 200.0)
    scene.write_text(scene.read_text().replace("[acquisition]", "[acquisition]\nrepeats = 3"))
    np.save(tmp_path / "a.npy", RF)
    runs = []
    for limit in (1 << 40, 1):
        monkeypatch.setattr(arrays, "MIN_MAPPED_BYTES", limit)
        runs.append(hpe.import_records(tmp_path / "a.npy", scene, tmp_path / f"{limit}.h5", **SETTINGS))
    for shot in range(6):
        np.testing.assert_array_equal(runs[0].records[shot].codes, runs[1].records[shot].codes)
        # The largest value has the code 32766.
        expected = np.rint(RF.reshape(6, 40, 160)[shot] * (32766 / np.abs(RF).max()))
        np.testing.assert_array_equal(runs[1].records[shot].codes, expected)
    assert runs[0].bench.recording == runs[1].bench.recording
