"""Damage is found, listed by shot and record, left out of results and measured again; files without checksums say so.

Bits are flipped in the file's bytes, behind the back of everything that knows of checksums.
"""

from __future__ import annotations

import itertools
import json
import os
import re
from collections.abc import Callable
from pathlib import Path

import h5py
import jsonschema
import numpy as np
import pytest
from typer.testing import CliRunner

from hpe_rig.cli.app import app
from hpe_rig.live.source import RunSource
from hpe_rig.measurement import Setup, prepare_text, record_run, resume
from hpe_rig.measurement.resumption import prepare_resumption
from hpe_rig.result import Result
from hpe_rig.runs import json_schema
from hpe_rig.runs.run import open_run, process
from hpe_rig.scene import shipped_scenes
from hpe_rig.store import StoreError, WriteOptions, list_runs, read_run, read_snapshots, result_path, verify
from hpe_rig.store.checksum import HEAP
from hpe_rig.store.damage import Damage, ranges

FIXTURES = Path(__file__).parents[2] / "fixtures" / "run_files"


@pytest.fixture(scope="module")
def setup() -> Setup:
    """Return a measurement of three shots of 260 records in chunks of 123."""
    text = shipped_scenes()["table-1"].replace("pulse_count = 101", "pulse_count = 260").replace("snr_db = 40.0", "")
    return prepare_text("small", text.replace("[acquisition]", "[acquisition]\nrepeats = 3\nrecord_samples = 4096"))


@pytest.fixture(scope="module")
def content(setup: Setup, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the bytes of a run file."""
    return record_run(setup, tmp_path_factory.mktemp("whole") / "run.h5").read_bytes()


@pytest.fixture(scope="module")
def whole(content: bytes, tmp_path_factory: pytest.TempPathFactory) -> tuple[Result, bytes]:
    """Return the result of the run file and the bytes of its result file."""
    path = tmp_path_factory.mktemp("processed") / "run.h5"
    path.write_bytes(content)
    result = process(path)
    return result, result_path(path, result.estimator).read_bytes()


@pytest.fixture
def processed(path: Path, whole: tuple[Result, bytes]) -> Path:
    """Return the result file beside the run file."""
    result = result_path(path, whole[0].estimator)
    result.write_bytes(whole[1])
    return result


@pytest.fixture
def path(content: bytes, tmp_path: Path) -> Path:
    """Return a run file."""
    path = tmp_path / "run.h5"
    path.write_bytes(content)
    return path


def flipped(path: Path, name: str, place: tuple[int, ...]) -> None:
    """Invert one bit of a value of dataset ``name``."""
    with h5py.File(path, "r+") as file:
        dataset = file[name]
        if dataset.chunks is None:
            offset = dataset.id.get_offset() + int(np.ravel_multi_index(place, dataset.shape)) * dataset.dtype.itemsize
        else:
            chunk = tuple(at // size * size for at, size in zip(place, dataset.chunks, strict=True))
            inside = np.ravel_multi_index(tuple(a - b for a, b in zip(place, chunk, strict=True)), dataset.chunks)
            offset = dataset.id.get_chunk_info_by_coord(chunk).byte_offset + int(inside) * dataset.dtype.itemsize
    with path.open("r+b") as raw:
        raw.seek(offset)
        byte = raw.read(1)[0]
        raw.seek(offset)
        raw.write(bytes([byte ^ 4]))


def test_a_sound_run_and_its_result_are_said_to_be_sound(path: Path, processed: Path) -> None:
    for file in (path, processed):
        done = CliRunner().invoke(app, ["verify", str(file)])
        assert done.exit_code == 0, done.output
        assert "sound" in done.output
    found = verify(path)
    assert (found.shots, found.shots_complete, found.records, found.checksums) == (3, 3, 780, True)


def test_one_bit_of_an_echo_costs_its_chunk_and_is_listed_by_shot_and_record(
    path: Path, whole: tuple[Result, bytes]
) -> None:
    flipped(path, "records/echo", (1, 130, 7))
    done = CliRunner().invoke(app, ["verify", str(path)])
    assert done.exit_code == 4
    assert "DAMAGED: shot 2: record 124 to 246 fail their checksums" in done.output
    done = CliRunner().invoke(app, ["verify", str(path), "--json"])
    jsonschema.Draft202012Validator(json_schema("verify")).validate(json.loads(done.stdout))
    assert json.loads(done.stdout)["damage"][0]["records"] == [[124, 246]]
    records = open_run(path).records[1]
    assert np.flatnonzero(~records.valid).tolist() == list(range(123, 246))
    found = process(path)
    assert [found.shots[shot].estimates == whole[0].shots[shot].estimates for shot in range(3)] == [True, False, True]
    assert any(text.startswith("123 of 260 records fail their checksums") for text in found.shots[1].warnings)
    assert not any("triggers were lost" in text for text in found.shots[1].warnings)


def test_the_live_page_of_a_damaged_run_says_so(path: Path) -> None:
    flipped(path, "records/echo", (2, 130, 7))
    assert (RunSource(path).poll() or {})["why"] == "123 records of this shot fail their checksums and are excluded"


@pytest.mark.parametrize(
    ("name", "place", "words"),
    [
        ("records/recorded", (0, 3), "record 1 to 123 fail"),
        pytest.param("records/trigger_time_s", (2, 259), "shot 3: record 247 to 260 fail", marks=pytest.mark.slow),
        ("checksum/records/echo", (0, 1), "record 124 to 246 fail"),
        pytest.param(
            "records/shot_complete", (1,), "shot 2: /records/shot_complete fails its checksum", marks=pytest.mark.slow
        ),
        pytest.param("records/clipped", (1,), "shot 2: /records/clipped fails its checksum", marks=pytest.mark.slow),
        pytest.param(
            "truth/displacement_m", (2, 5), "shot 3: /truth/displacement_m fails its checksum", marks=pytest.mark.slow
        ),
        pytest.param(
            "true_harmonics/in_phase_m",
            (0, 0),
            "shot 1: /true_harmonics/in_phase_m fails its checksum",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            "records/burst_length_s", (1,), "/records/burst_length_s fails its checksum", marks=pytest.mark.slow
        ),
    ],
)
def test_one_bit_of_anything_is_found_and_of_what_a_result_uses_said_with_it(
    path: Path, name: str, place: tuple[int, ...], words: str
) -> None:
    flipped(path, name, place)
    found = [str(damage) for damage in verify(path).damage]
    assert any(words in text for text in found), found
    result = process(path)
    said = [*result.warnings, *(text for shot in result.shots for text in shot.warnings)]
    used = name not in ("records/burst_length_s",)
    assert any("checksum" in text or "damaged" in text for text in said) == used, said


def test_damaged_settings_are_left_out_and_a_damaged_scene_is_refused(path: Path) -> None:
    flipped(path, "snapshot", (1,))
    assert len(read_snapshots(path)) == 2
    assert list(map(str, read_run(path).damage)) == ["shot 2: /snapshot fails its checksum: its settings are left out"]
    with h5py.File(path, "r") as file:
        offset = file["scene"].id.get_offset()
    data = bytearray(path.read_bytes())
    # No longer UTF-8: the checksum is compared before the text is decoded.
    data[offset + 20] ^= 0x80
    path.write_bytes(data)
    with pytest.raises(StoreError, match=r"/scene fails its checksum"):
        read_run(path)


def test_damage_is_listed_by_shot(path: Path) -> None:
    flipped(path, "records/echo", (0, 130, 7))
    flipped(path, "snapshot", (1,))
    flipped(path, "records/burst_length_s", (1,))
    flipped(path, "records/pulse_onset_s", (0, 3))
    assert [damage.shot for damage in verify(path).damage] == [None, 0, 0, 1]


def test_echoes_of_a_long_shot_that_change_after_their_verification_are_refused(path: Path) -> None:
    records = read_run(path).records
    shot = records.gated_or_stored(1, slice(100, 120), 5, max_samples=0)
    expected = shot.block(slice(None))
    np.testing.assert_array_equal(expected, records.gated_or_stored(1, slice(100, 120), 5).block(slice(None)))
    flipped(path, "records/echo", (1, 130, 7))
    np.testing.assert_array_equal(shot.block(slice(0, 123)), expected[:123])
    with pytest.raises(StoreError, match="shot 2 was changed while it was read"):
        shot.block(slice(120, 140))


def test_records_of_a_run_that_another_run_has_replaced_are_refused(path: Path) -> None:
    records = read_run(path).records
    path.write_bytes((FIXTURES / "specimen.h5").read_bytes())
    with pytest.raises(StoreError, match=r"replaced by a run of \(2, 119, 192\) instead of \(3, 260, 4096\)"):
        records.placement(0)


@pytest.mark.parametrize("harm", ["echo", pytest.param("cut", marks=pytest.mark.slow)])
def test_a_damaged_shot_is_measured_again_when_the_run_goes_on(
    path: Path, whole: tuple[Result, bytes], harm: str
) -> None:
    if harm == "echo":
        flipped(path, "records/echo", (1, 130, 7))
    else:
        with path.open("r+b") as file:
            file.truncate(int(path.stat().st_size * 0.8))
    rest = prepare_resumption(path)
    assert rest.complete == (1 if harm == "echo" else 2)
    assert process(resume(rest)).shots == whole[0].shots


@pytest.mark.parametrize("compress", [pytest.param(False, marks=pytest.mark.slow), True], ids=["plain", "compressed"])
def test_a_file_that_is_cut_short_says_so_and_its_end_counts_as_missing(
    setup: Setup, tmp_path: Path, compress: bool
) -> None:
    path = record_run(setup, tmp_path / "cut.h5", options=WriteOptions(compress))
    with path.open("r+b") as file:
        file.truncate(int(path.stat().st_size * 0.8))
    result = process(path)
    assert any("the file is cut short" in text for text in result.warnings)
    assert any("fail their checksums" in text for shot in result.shots for text in shot.warnings) or any(
        "fail their checksums" in why for _, why in result.shots_without_result
    )


def test_a_run_of_which_every_record_is_damaged_asks_for_another_copy(path: Path) -> None:
    for shot, record in itertools.product(range(3), range(0, 260, 123)):
        flipped(path, "records/echo", (shot, record, 7))
    with pytest.raises(StoreError, match=r"fail their checksums.*Try: another copy of the file, or hpe-rig resume"):
        process(path)


def test_a_file_of_an_earlier_release_is_read_and_said_to_have_no_checksums(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["verify", str(FIXTURES / "specimen.h5")])
    assert done.exit_code == 5, done.output
    assert "no checksums" in done.output
    # What it does not hold counts as missing there too, and is not taken for 0 V.
    cut = tmp_path / "cut.h5"
    data = (FIXTURES / "specimen.h5").read_bytes()
    cut.write_bytes(data[: int(len(data) * 0.8)])
    done = CliRunner().invoke(app, ["verify", str(cut)])
    assert done.exit_code in (2, 4), done.output
    assert "Traceback" not in done.output


@pytest.mark.parametrize("make", [lambda path: path.write_bytes(b"text"), lambda path: path.mkdir(), lambda path: None])
def test_what_is_no_file_of_hpe_rig_is_a_message(tmp_path: Path, make: Callable[[Path], None]) -> None:
    make(tmp_path / "other.h5")
    done = CliRunner().invoke(app, ["verify", str(tmp_path / "other.h5")])
    assert done.exit_code == 2
    assert "Try:" in done.output


def test_a_result_holds_the_estimates_of_its_shots_and_no_records(processed: Path) -> None:
    found = verify(processed)
    assert (found.kind, found.shots, found.shots_complete, found.records) == ("result", 3, 3, 0)


def test_a_damaged_result_is_found(processed: Path) -> None:
    with h5py.File(processed, "r") as file:
        offset = file["results/amplitude_m"].id.get_offset()
    data = bytearray(processed.read_bytes())
    data[offset] ^= 1
    processed.write_bytes(data)
    (damage,) = verify(processed).damage
    assert str(damage) == "/results/amplitude_m fails its checksum"


@pytest.mark.parametrize("kind", ["run", "result"])
def test_damaged_units_and_axes_are_found_without_asking_the_library_for_them(
    path: Path, processed: Path, kind: str
) -> None:
    """Texts of variable length and references lie in a heap for which HDF5 does not vouch."""
    damaged, name = (path, "records/sample") if kind == "run" else (processed, "motion/time_s")
    data = bytearray(damaged.read_bytes())
    data[data.index(b"time ", data.index(b"GCOL"))] ^= 1
    damaged.write_bytes(data)
    with h5py.File(damaged, "r") as file:
        assert file[name].attrs["long_name"].startswith("uime ")
    (damage,) = verify(damaged).damage
    assert str(damage) == "units or axes of datasets fail their checksum"


def test_a_file_from_before_heaps_were_vouched_for_is_sound(path: Path) -> None:
    with h5py.File(path, "r+", libver=("v110", "v110")) as file:
        del file.attrs[HEAP]
    assert not verify(path).damage


@pytest.mark.parametrize(
    "foreign",
    ["text", *(pytest.param(value, marks=pytest.mark.slow) for value in (3.0, h5py.Empty("f8")))],
    ids=["text", "number", "empty"],
)
def test_checksums_of_the_heap_that_are_none_are_damage(path: Path, foreign: object) -> None:
    with h5py.File(path, "r+", libver=("v110", "v110")) as file:
        file.attrs[HEAP] = foreign
    (damage,) = verify(path).damage
    assert str(damage) == "units or axes of datasets fail their checksum"


def test_a_listing_does_not_state_what_a_damaged_result_says(processed: Path) -> None:
    stated = CliRunner().invoke(app, ["list", str(processed.parent)]).stdout
    digit = re.search(rb'"amplitude_m": [0-9.]*([1-8])', processed.read_bytes())
    assert digit is not None
    data = bytearray(processed.read_bytes())
    data[digit.start(1)] ^= 1
    processed.write_bytes(data)
    done = CliRunner().invoke(app, ["list", str(processed.parent)])
    assert " nm" in stated
    assert " nm" not in done.output
    assert "run.coherent.h5 is no readable result file (it fails its checksum). Try: hpe-rig process" in done.output


def test_a_listing_does_not_state_the_result_of_an_earlier_run_of_that_name(
    setup: Setup, path: Path, processed: Path
) -> None:
    assert processed.exists()
    assert list_runs(path.parent)[0][0].lead is not None
    record_run(setup, path, options=WriteOptions(overwrite=True, run_id="b" * 32))
    (entry,), unreadable = list_runs(path.parent)
    assert (entry.lead, unreadable) == (None, [])
    process(path)
    assert list_runs(path.parent)[0][0].lead is not None


@pytest.mark.skipif(os.name == "nt", reason="named pipes are POSIX's")
@pytest.mark.parametrize(
    "arguments",
    [
        ["list", "."],
        *(pytest.param(words, marks=pytest.mark.slow) for words in (["verify", "pipe.h5"], ["process", "run.h5"])),
    ],
)
def test_a_named_pipe_is_not_waited_for(path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str]) -> None:
    monkeypatch.chdir(path.parent)
    os.mkfifo(path.with_name("pipe.h5"))
    os.mkfifo(result_path(path, "coherent"))
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == (0 if arguments[0] == "list" else 2)
    assert "Try:" in done.output


def test_ranges_are_first_and_last_of_each_row() -> None:
    assert ranges(np.array([], bool)) == ()
    assert ranges(np.array([False, True, True, False, True])) == ((1, 2), (4, 4))
    assert ranges(np.ones(3, bool)) == ((0, 2),)


def test_damage_is_told_by_shots_and_records_as_people_count() -> None:
    assert str(Damage("is bad")) == "is bad"
    assert str(Damage("fail", 1, ((0, 0), (4, 6)))) == "shot 2: record 1, 5 to 7 fail"


def test_another_programs_hdf5_file_is_no_run_file(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        del file.attrs["format"]
    with pytest.raises(StoreError, match="a result file or another program's"):
        read_run(path)
