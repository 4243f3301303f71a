"""HDF5 files of unknown origin: limits of objects, sizes and types, and what is said of each."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from hpe_rig.store import StoreError, foreign_hdf5
from hpe_rig.store.checksum import ATTRIBUTE, crc, digest, heap_is_sound, kind_of, sealed_file, stored_bytes
from hpe_rig.store.foreign_hdf5 import (
    InvalidContentError,
    bytes_in_memory,
    max_bytes_of,
    objects,
    open_bounded,
    refuse_expansion,
)
from hpe_rig.store.format import extra, free_path, reason, result_path
from hpe_rig.store.validation import CheckedFile, declared_size, filters, open_hdf5, stored_values


@pytest.fixture
def file(tmp_path: Path) -> Any:
    with h5py.File(tmp_path / "a.h5", "w", libver="v110") as opened:
        yield opened


def test_each_object_is_listed_once_and_soft_links_are_not_followed(file: h5py.File) -> None:
    file["a/b"] = np.zeros(3)
    file["a/c"] = file["a/b"]
    file["a/loop"] = file["a"]
    file["soft"] = h5py.SoftLink("/a/b")
    assert [name for name, _ in objects(file)] == ["a", "a/b"]


def test_links_and_values_in_other_files_are_refused_by_name(file: h5py.File) -> None:
    file["inside"] = np.zeros(3)
    file["a"] = h5py.ExternalLink("other.h5", "/b")
    with pytest.raises(InvalidContentError, match="/a is a link to another file"):
        list(objects(file))
    del file["a"]
    file.create_dataset("outside", shape=(3,), dtype="f8", external=[("values.bin", 0, 24)])
    with pytest.raises(InvalidContentError, match="/outside keeps its values in another file"):
        list(objects(file))
    del file["outside"]
    layout = h5py.VirtualLayout((3,), "f8")
    layout[:] = h5py.VirtualSource("other.h5", "b", (3,))
    file.create_virtual_dataset("group/virtual", layout)
    with pytest.raises(InvalidContentError, match="/group/virtual keeps its values in another file"):
        list(objects(file))


def test_depth_and_number_of_objects_are_limited(file: h5py.File, monkeypatch: pytest.MonkeyPatch) -> None:
    file["/".join("g" * 32)] = h5py.Empty("f8")
    assert len(list(objects(file))) == 32
    file["/".join("g" * 31) + "/h/i"] = h5py.Empty("f8")
    with pytest.raises(InvalidContentError, match="it has more than 32 groups within each other"):
        list(objects(file))
    del file["g"]
    monkeypatch.setattr(foreign_hdf5, "MAX_OBJECTS", 5)
    for number in range(5):
        file[f"d{number}"] = number
    assert len(list(objects(file))) == 5
    file["d5"] = 5
    with pytest.raises(InvalidContentError, match="it has more than 5 groups and datasets"):
        list(objects(file))


def test_a_dataset_may_expand_to_twenty_times_its_file_or_a_quarter_of_a_gigabyte(
    file: h5py.File, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = Path(file.filename)
    assert max_bytes_of(path) == 256_000_000
    monkeypatch.setattr(foreign_hdf5, "MIN_BYTES", 1000)
    file["a"] = np.zeros(125)
    chunked = file.create_dataset("c", (10, 10), "i2", chunks=(4, 8))
    large_chunk = file.create_dataset("d", (1,), "f8", chunks=(64,), maxshape=(None,))
    sizes = [bytes_in_memory(item) for item in (file["a"], chunked, large_chunk)]
    assert sizes == [1000, 200, 512]
    file.flush()
    size = path.stat().st_size
    assert max_bytes_of(path) == 20 * size
    refuse_expansion(1000, 1000, "/a")
    with pytest.raises(InvalidContentError, match=r"/a takes 0\.001001 MB, more than the 0\.001 MB"):
        refuse_expansion(1001, 1000, "/a")
    file.create_dataset("zeros", (4_000_000,), "f8", compression="gzip")
    file.close()
    with pytest.raises(InvalidContentError, match="/zeros takes 32 MB"), open_bounded(path):
        pass


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (OSError(28, "No space left on device"), "No space left on device"),
        (
            OSError("Unable to write (file write failed: error message = 'Disk quota exceeded', x)"),
            "Disk quota exceeded",
        ),
        (OSError(0, "Unable to synchronously open file (truncated file: eof)"), "it is cut short"),
        (OSError("unable to open (file signature not found)"), "it is not an HDF5 file"),
        (KeyError("object 'a' doesn't exist"), "something in it is missing"),
        (MemoryError(), "it needs more memory than is available"),
        (RuntimeError("can't start new thread"), "it needs more memory than is available"),
        (OSError("unable to lock file, errno = 11"), "another program has it open"),
        (OSError("filter returned failure during read"), "its records cannot be decompressed"),
        (RuntimeError("wrong checksum"), "its bytes do not match their checksums"),
        (RuntimeError("x"), "the HDF5 library cannot read it"),
        (InvalidContentError("/a is absent"), "/a is absent"),
    ],
)
def test_the_cause_of_an_error_is_said_in_plain_words(error: Exception, words: str) -> None:
    assert reason(error) == words


def test_free_names_count_from_two_and_results_have_the_name_of_their_run(tmp_path: Path) -> None:
    assert free_path("run", tmp_path) == tmp_path / "run.h5"
    for name in ("run.h5", "run-2.h5"):
        (tmp_path / name).touch()
    assert free_path("run", tmp_path) == tmp_path / "run-3.h5"
    assert result_path(tmp_path / "run.h5", "kasai") == tmp_path / "run.kasai.h5"
    with (
        pytest.raises(
            StoreError, match=r'this needs no_such_package, which is not installed. Try: pip install "hpe-rig\[x'
        ),
        extra("x"),
    ):
        import no_such_package  # type: ignore[import-not-found]  # noqa: F401


def test_the_header_of_a_file_states_its_length_and_other_files_are_named(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    path.write_bytes(sealed_file(lambda file: file.create_dataset("a", data=[1.0])))
    assert declared_size(path) == path.stat().st_size
    content = path.read_bytes()
    for kind, problem in ((tmp_path, "is a folder"), (tmp_path / "b", "does not exist")):
        with pytest.raises(StoreError, match=problem):
            declared_size(kind)
    for changed, words in (
        (b"no HDF5 file", "it is not an HDF5 file"),
        (content[:35], "it is an HDF5 file of another kind"),
        (content[:8] + b"\x02" + content[9:], "a superblock of version 3"),
    ):
        path.write_bytes(changed)
        with pytest.raises(InvalidContentError, match=words):
            declared_size(path)
    path.write_bytes(content[:36])
    assert declared_size(path) == len(content)


def test_checksums_depend_on_name_index_and_content_and_are_never_zero() -> None:
    for checksum in (digest, crc):
        sums = {
            checksum("a", (0,), b"12"), checksum("b", (0,), b"12"), checksum("a", (1,), b"12"),
            checksum("a", (0,), b"13"), checksum("a", (), b"12"),
        }  # fmt: skip
        assert len(sums) == 5
        assert checksum("a", (0,), b"1", b"2") == checksum("a", (0,), b"12")
        assert all(0 < value < 2**64 for value in sums)
    assert crc("a", (0,), b"12") < 2**32
    assert stored_bytes([1, 2], np.dtype("<i2")) == b"\x01\x00\x02\x00"


def test_a_sealed_file_has_a_checksum_for_each_dataset_and_for_its_heap(tmp_path: Path) -> None:
    def write(file: h5py.File) -> None:
        file["a"] = np.arange(3.0)
        file["a"].attrs["units"] = "metres " * 10

    path = tmp_path / "a.h5"
    path.write_bytes(sealed_file(write))
    assert path.read_bytes() == sealed_file(write)
    with h5py.File(path, "r") as file:
        assert int(file["a"].attrs[ATTRIBUTE]) == digest("a", (), np.arange(3.0).tobytes())
        assert CheckedFile(file).matches_checksum("a", file["a"])
        assert heap_is_sound(file, path)
    content = bytearray(path.read_bytes())
    content[content.find(b"metres")] ^= 1
    path.write_bytes(content)
    with h5py.File(path, "r") as file:
        assert not heap_is_sound(file, path)


def test_the_kind_of_a_file_is_known_by_its_attributes(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    kinds: list[tuple[Callable[[h5py.File], Any], str | None]] = [
        (lambda file: file.attrs.update({"format_version": 3, "scene_name": "a"}), "run"),
        (lambda file: file.attrs.update({"run_file": "a", "estimator": "a"}), "result"),
        (lambda file: file.attrs.update({"run_file": "a"}), ""),
        (
            lambda file: (file.attrs.update({"heap_checksum": 0}), file.create_dataset("velocity_m_per_s", data=0)),
            "map",
        ),
        (lambda file: file.create_dataset("velocity_m_per_s", data=0), ""),
    ]
    for write, kind in kinds:
        with h5py.File(path, "w") as file:
            write(file)
        assert kind_of(path) == kind
    path.write_bytes(b"no HDF5 file")
    assert kind_of(path) is None
    assert kind_of(tmp_path) is None


def test_only_single_values_of_the_expected_type_are_read_from_attributes(file: h5py.File) -> None:
    checked = CheckedFile(file)
    file.attrs.update({"whole": 3, "real": 2.5, "yes": True, "many": [1, 2], "nan": np.nan})
    file.attrs["text"] = np.array("M\u00fcller".encode(), dtype=h5py.string_dtype("utf-8", 7))
    file.attrs["long"] = "of variable length"
    file.attrs["control"] = np.array(b"a\x1b[2Jb", dtype="S8")
    file.attrs["latin"] = np.array(b"M\xfcller", dtype="S8")
    file["a"] = [1.0]
    file["a"].attrs["unit"] = np.array(b"m", "S1")
    assert [checked.attribute(name, kind) for name, kind in (("whole", int), ("real", float), ("yes", bool))] == [
        3,
        2.5,
        True,
    ]
    assert checked.attribute("text", str) == "M\u00fcller"
    assert checked.attribute("unit", str, "a") == "m"
    for name, kind, words in (
        ("absent", int, r"attribute \.absent is absent"),
        ("many", int, "is not a single value"),
        ("real", int, "is not of type int"),
        ("whole", float, "is not of type float"),
        ("whole", str, "is not text"),
        ("nan", float, "is nan"),
        ("long", str, "is a text of variable length"),
        ("control", str, "holds control characters"),
        ("latin", str, "is not UTF-8 text"),
    ):
        with pytest.raises(InvalidContentError, match=words):
            checked.attribute(name, kind)


def test_only_datasets_of_the_expected_type_and_shape_are_read(file: h5py.File) -> None:
    checked = CheckedFile(file)
    file["a"] = np.zeros((2, 3), "<f8")
    file["group/b"] = np.zeros(2, "<i2")
    file["soft"] = h5py.SoftLink("/a")
    file.create_dataset("packed", (4,), "<f8", chunks=(2,), compression="gzip")
    file.create_dataset("summed", (4,), "<f8", chunks=(2,), fletcher32=True)
    file.create_dataset("large", (1,), "<f8", chunks=(8_000_001,), maxshape=(None,))
    assert checked.dataset_of_type("a", "<f8", (2, None)).shape == (2, 3)
    assert checked.dataset_of_type("summed", "<f8", (4,)).shape == (4,)
    assert [filters(file[name]) for name in ("a", "packed", "summed")] == [[], [1], [3]]
    assert checked.has("group/b")
    assert not checked.has("group/c")
    for name, dtype, shape, words in (
        ("a", "<i2", (2, 3), "/a holds float64, not int16"),
        ("a", "<f8", (3, 3), r"/a has shape \(2, 3\), where \(3, 3\) fits"),
        ("a", "<f8", (2,), "/a has shape"),
        ("group", "<f8", (), "/group is not a dataset"),
        ("group/c", "<f8", (), "/group/c is absent"),
        ("soft", "<f8", (2, 3), "/soft is a link to another object"),
        ("packed", "<f8", (4,), r"/packed went through filters \[1\]"),
        ("large", "<f8", (1,), "larger than any run file's"),
    ):
        with pytest.raises(InvalidContentError, match=words):
            checked.dataset_of_type(name, dtype, shape)


def test_values_of_a_chunk_that_fails_its_checksum_are_replaced_and_the_others_read(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    with h5py.File(path, "w", libver="v110") as file:
        dataset = file.create_dataset("a", data=np.arange(1.0, 5.0), chunks=(2,), fletcher32=True)
        offset = dataset.id.get_chunk_info(1).byte_offset
    content = bytearray(path.read_bytes())
    content[offset] ^= 1
    path.write_bytes(content)
    with open_hdf5(path) as file:
        values = stored_values(file["a"])
        assert values[:2].tolist() == [1.0, 2.0]
        assert np.isnan(values[2:]).all()
        assert stored_values(file["a"], (slice(0, 1),)).tolist() == [1.0]
