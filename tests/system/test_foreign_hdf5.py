"""Files of others that refer to further files or expand without bound are refused, with little memory and at once."""

from __future__ import annotations

import shutil
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.io import savemat

import hpe_rig as hpe
from hpe_rig.prediction.linear_fit import PULSES_PER_BLOCK, summed_harmonics_m
from hpe_rig.processing.harmonics.model import harmonic_columns
from hpe_rig.recordings.importers import read_contents
from hpe_rig.recordings.settings import RecordingSettings
from hpe_rig.store import StoreError, foreign_hdf5, list_runs, read_covariance, verify, write_result
from hpe_rig.store.foreign_hdf5 import MAX_DEPTH
from sim_backend.transducer.hydrophone import _columns

FIXTURES = Path(__file__).parents[1] / "fixtures" / "run_files"
SHAPE = (60, 512)


def secret_of(folder: Path) -> list[tuple[str, int, int]]:
    """Write a file with secret bytes; return it as the external storage of a dataset."""
    (folder / "secret").write_bytes(bytes(range(256)) * 240)
    return [(str(folder / "secret"), 0, 2 * 60 * 512)]


def external_storage(file: h5py.File, folder: Path) -> None:
    file.create_dataset("rf", SHAPE, "i2", external=secret_of(folder))


def external_element(file: h5py.File, folder: Path) -> None:
    """Write a cell of MATLAB with an element whose values are in another file."""
    element = file.create_dataset("#refs#/a", SHAPE, "i2", external=secret_of(folder))
    file.create_dataset("rf", (1, 1), h5py.ref_dtype)[0, 0] = element.ref


def external_link(file: h5py.File, folder: Path) -> None:
    file["rf"] = h5py.ExternalLink(str(folder / "other.h5"), "rf")


def virtual_dataset(file: h5py.File, folder: Path) -> None:
    layout = h5py.VirtualLayout(SHAPE, "f8")
    layout[...] = h5py.VirtualSource(str(folder / "other.h5"), "rf", SHAPE)
    file.create_virtual_dataset("rf", layout)


def never_written(file: h5py.File, folder: Path) -> None:
    file.create_dataset("rf", (20_000, 16_000), chunks=(10, 1_600), compression="gzip", dtype="f8")


def large_chunk(file: h5py.File, folder: Path) -> None:
    file.create_dataset("rf", SHAPE, "f8", chunks=(60_000, 5_120), maxshape=(None, None), compression="gzip")


def nested(file: h5py.File, folder: Path) -> None:
    group: h5py.Group = file
    for _ in range(MAX_DEPTH + 1):
        group = group.create_group("g")
    group["rf"] = np.ones(SHAPE)


HDF5 = {
    "external storage": (external_storage, "keeps its values in another file"),
    "external element": (external_element, "keeps its values in another file"),
    "external link": (external_link, "is a link to another file"),
    "virtual dataset": (virtual_dataset, "keeps its values in another file"),
    "never written": (never_written, "takes 2560 MB, more than the"),
    "large chunk": (large_chunk, "takes 2457.6 MB, more than the"),
    "nested": (nested, f"more than {MAX_DEPTH} groups within each other"),
}
"""Writer of each file that is refused, and the words of its message."""


@pytest.fixture(scope="module")
def result_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a result file."""
    path = tmp_path_factory.mktemp("result") / "run.coherent.h5"
    write_result(path, hpe.open_run(FIXTURES / "specimen.h5").estimate("coherent"))
    return path


def peak_bytes(action: Callable[[], object]) -> int:
    """Return the peak of the memory that Python and NumPy allocate in ``action``."""
    tracemalloc.start()
    try:
        action()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("kind", HDF5)
def test_an_import_refuses_what_lies_elsewhere_or_expands_without_bound(kind: str, tmp_path: Path) -> None:
    write, words = HDF5[kind]
    with h5py.File(tmp_path / "rf.h5", "w") as file:
        write(file, tmp_path)

    def read() -> None:
        with pytest.raises(ValueError, match=words):
            read_contents(tmp_path / "rf.h5", RecordingSettings())

    assert peak_bytes(read) < 20e6


@pytest.mark.parametrize("of", ["run", "result"])
@pytest.mark.parametrize("kind", HDF5)
def test_verify_refuses_it_in_a_file_of_this_program(kind: str, of: str, result_file: Path, tmp_path: Path) -> None:
    write, words = HDF5[kind]
    path = Path(shutil.copy(FIXTURES / "specimen.h5" if of == "run" else result_file, tmp_path / "file.h5"))
    with h5py.File(path, "r+") as file:
        write(file, tmp_path)
        if isinstance(file.get("rf", getlink=True), h5py.HardLink):
            file["rf"].attrs["checksum"] = np.uint64(1)

    def read() -> None:
        with pytest.raises(StoreError, match=words):
            verify(path)

    assert peak_bytes(read) < 40e6


def test_a_list_and_the_covariance_of_a_result_do_not_follow_its_link(result_file: Path, tmp_path: Path) -> None:
    run, result = Path(shutil.copy(FIXTURES / "specimen.h5", tmp_path / "run.h5")), tmp_path / "run.coherent.h5"
    shutil.copy(result_file, result)
    with h5py.File(result, "r+") as file:
        del file["json"]
        file["json"] = h5py.ExternalLink(str(result_file), "json")
    entries, unreadable = list_runs(run.parent)
    assert "/json is a link to another file" in " ".join(unreadable)
    with pytest.raises(StoreError, match=r"no covariance can be read \(/json is a link to another file\)"):
        read_covariance(result)
    assert not entries


@pytest.mark.parametrize("kind", ["external storage", "virtual dataset"])
def test_a_hydrophone_scan_is_not_read_from_another_file(kind: str, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "scan.h5", "w") as file:
        HDF5[kind][0](file, tmp_path)
    with pytest.raises(ValueError, match="/rf keeps its values in another file"):
        _columns(tmp_path / "scan.h5")


def test_the_check_of_a_refused_scene_with_millions_of_pulses_predicts_nothing() -> None:
    scene = hpe.load_scene("bovine-muscle").with_(
        {"tracking.pulse_rate_hz": 2.2e6, "processing.window_start_s": 0.05, "processing.window_length_s": 0.1}
    )
    texts = list[str]()
    assert peak_bytes(lambda: texts.append(str(hpe.check(scene)))) < 300e6
    assert "prediction: omitted, the scene is refused and has more than 100000 pulses in a shot" in texts[0]


def test_the_motion_of_a_long_train_is_summed_in_blocks() -> None:
    time_s, frequency_hz = np.arange(PULSES_PER_BLOCK + 900) / 4e3, 100.0 * np.arange(1, 5)
    quadratures_m = np.arange(1.0, 9.0)
    summed_m = summed_harmonics_m(time_s, frequency_hz, quadratures_m)
    # The rounding of a phase of 1e4 cycles, times the sum of the amplitudes.
    expected_m = harmonic_columns(time_s, frequency_hz) @ quadratures_m
    np.testing.assert_allclose(summed_m, expected_m, atol=36 * 1e4 * 2 * np.pi * np.finfo(float).eps)


@pytest.mark.parametrize("suffix", [".npz", ".mat"])
def test_a_compressed_array_is_refused_before_it_is_expanded(
    suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(foreign_hdf5, "MIN_BYTES", 8_000_000)
    path, zeros = tmp_path / f"rf{suffix}", np.zeros((1000, 12_000), np.int8)
    if suffix == ".npz":
        np.savez_compressed(path, rf=zeros)
    else:
        # The process that reads MATLAB files may take three times as much.
        savemat(path, {f"rf{number}": zeros for number in range(4)}, do_compression=True)
    assert path.stat().st_size < 100_000

    def read() -> None:
        with pytest.raises(ValueError, match="than the 8 MB"):
            read_contents(path, RecordingSettings())

    assert peak_bytes(read) < 8e6


@pytest.mark.parametrize("values", [np.zeros(3), np.zeros((1, 1, 2), "S4"), 0.0])
def test_a_covariance_with_values_of_another_kind_is_refused(values: object, result_file: Path, tmp_path: Path) -> None:
    result = Path(shutil.copy(result_file, tmp_path / "run.coherent.h5"))
    with h5py.File(result, "r+") as file:
        del file["covariance/phasor_m"]
        file["covariance/phasor_m"] = values
    with pytest.raises(StoreError, match="no covariance can be read"):
        read_covariance(result)
