"""Reading a tampered run file ends in a result or a message: no traceback, no crash, no other file is opened."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from hpe_rig.measurement import request_stop
from hpe_rig.measurement.resumption import prepare_resumption
from hpe_rig.measurement.run import record_run
from hpe_rig.measurement.setup import prepare_text
from hpe_rig.plan.checks.check_result import PlanError
from hpe_rig.report.page import render
from hpe_rig.runs import open_run
from hpe_rig.runs.run import process
from hpe_rig.scene import SettingsError, shipped_scenes
from hpe_rig.store import StoreError, read_run, read_snapshots

MESSAGES = (StoreError, SettingsError, PlanError)
SMALL = (
    ("pulse_count = 101", "pulse_count = 48"),
    ("[acquisition]", "[acquisition]\nrecord_samples = 256"),
)
LIBRARY_WORDS = re.compile(r"nable to|synchronously|errno|H5[A-Z]|0x[0-9a-f]")
"""Words in messages of the HDF5 library, which would not help the user."""
MAX_S = 5.0
"""Processor time for reading one file."""
MAX_BYTES = 1 << 30
"""Memory for reading, beyond that of the process before."""


needs_linux = pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs fork and Linux's memory limits")


@pytest.fixture(scope="module")
def intact(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a small run file with its result beside it."""
    text = shipped_scenes()["table-1"]
    for old, new in SMALL:
        assert old in text, old
        text = text.replace(old, new)
    path = record_run(prepare_text("table-1", text), tmp_path_factory.mktemp("intact") / "run.h5")
    process(path)
    return path


@pytest.fixture(scope="module")
def small_run_bytes(intact: Path, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return a small run file without checksums, as of early releases: checksums would detect every change first."""
    path = tmp_path_factory.mktemp("tampered") / "run.h5"
    path.write_bytes(intact.read_bytes())
    _delete(path, "checksum")
    attribute("format_version", 2)(path)
    return path.read_bytes()


@pytest.fixture
def small(small_run_bytes: bytes, tmp_path: Path) -> Path:
    """Return a copy of the small run file."""
    path = tmp_path / "run.h5"
    path.write_bytes(small_run_bytes)
    return path


def fixed_length(text: str) -> Any:
    """Return ``text`` as run files store it."""
    return np.array(text.encode(), dtype=h5py.string_dtype("utf-8", len(text.encode())))


def contents(data: bytes) -> Callable[[Path], None]:
    """Return a change that replaces the whole file."""

    def change(path: Path) -> None:
        path.write_bytes(data)

    return change


def replace_dataset(path: Path, name: str, **changes: Any) -> None:
    """Replace dataset ``name`` by one created with ``changes``; its attributes stay."""
    with h5py.File(path, "r+", libver=("v110", "v110")) as file:
        attributes = dict(file[name].attrs)
        del file[name]
        file.create_dataset(name, **changes).attrs.update(attributes)


def make_pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def make_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def attribute(name: str, value: Any, owner: str = "/") -> Callable[[Path], None]:
    """Return a change that sets an attribute."""

    def change(path: Path) -> None:
        with h5py.File(path, "r+", libver=("v110", "v110")) as file:
            del file[owner].attrs[name]
            file[owner].attrs[name] = fixed_length(value) if isinstance(value, str) else value

    return change


def link(name: str, target: Any) -> Callable[[Path], None]:
    """Return a change that replaces an object by a link."""

    def change(path: Path) -> None:
        with h5py.File(path, "r+", libver=("v110", "v110")) as file:
            file.move(name, "elsewhere")
            file[name] = target

    return change


def echoes_as_group(path: Path) -> None:
    with h5py.File(path, "r+", libver=("v110", "v110")) as file:
        del file["records/echo"]
        file.create_group("records/echo")


def values_in_another_file(path: Path) -> None:
    """Move a dataset's values to another file."""
    external = path.with_name("secret.bin")
    external.write_bytes(bytes(48 * 8))
    replace_dataset(path, "records/trigger_time_s", shape=(1, 48), dtype="<f8", external=[(str(external), 0, 48 * 8)])


def view_of_another_file(path: Path) -> None:
    """Replace a dataset by a view of a dataset in another file."""
    layout = h5py.VirtualLayout((1, 48), "<f8")
    layout[...] = h5py.VirtualSource(str(path.with_name("other.h5")), "x", (1, 48))
    with h5py.File(path, "r+", libver=("v110", "v110")) as file:
        del file["records/trigger_time_s"]
        file.create_virtual_dataset("records/trigger_time_s", layout)


def scene_with(old: str, new: str) -> Callable[[Path], None]:
    """Return a change that edits the stored scene."""

    def change(path: Path) -> None:
        with h5py.File(path, "r+", libver=("v110", "v110")) as file:
            text = file["scene"].asstr()[()]
            assert old in text
            del file["scene"]
            file["scene"] = fixed_length(text.replace(old, new))

    return change


def values(name: str, value: Any) -> Callable[[Path], None]:
    """Return a change that overwrites a dataset's values."""

    def change(path: Path) -> None:
        with h5py.File(path, "r+", libver=("v110", "v110")) as file:
            file[name][...] = value

    return change


def replaced(name: str, **changes: Any) -> Callable[[Path], None]:
    """Return a change that replaces a dataset."""
    return lambda path: replace_dataset(path, name, **changes)


HUGE = (1, 1_000_000, 10_000_000)
TAMPERED: dict[str, tuple[Callable[[Path], None], str]] = {
    "empty": (contents(b""), "not an HDF5 file"),
    "text": (contents(b"[scene]"), "not an HDF5 file"),
    "signature alone": (contents(b"\x89HDF\r\n\x1a\n"), "another kind"),
    "a pipe": (make_pipe, "not a regular file"),
    "a folder": (make_folder, "is a folder"),
    "absent": (lambda path: path.unlink(), "does not exist"),
    "another program's": (attribute("format", "NeXus"), "another program"),
    "a newer version": (attribute("format_version", 99), "newer hpe-rig"),
    "an older version": (attribute("format_version", 1), "older than the first supported version, 2"),
    "a version in words": (attribute("format_version", "two"), "is not of type int"),
    "a version in a list": (attribute("format_version", np.arange(5)), "not a single value"),
    "an unknown status": (attribute("status", "perfect"), "status is 'perfect'"),
    "escape codes in the status": (attribute("status", "\x1b[2J"), "control characters"),
    "no scene name": (attribute("scene_name", 3.0), "is not text"),
    "NaN volts": (attribute("scale_factor", np.nan, "records/echo"), "is nan"),
    "other volts": (attribute("scale_factor", 1e-3, "records/echo"), "V per code"),
    "infinite volts": (attribute("add_offset", np.inf, "records/echo"), "is inf"),
    "an external link": (
        link("records/echo", h5py.ExternalLink("/etc/passwd", "/echo")),
        "is a link to another object",
    ),
    "a soft link": (link("records/echo", h5py.SoftLink("/elsewhere")), "is a link to another object"),
    "values in another file": (values_in_another_file, "another file"),
    "a view of another file": (view_of_another_file, "another file"),
    "echoes that are a group": (echoes_as_group, "is not a dataset"),
    "floating echoes": (replaced("records/echo", shape=(1, 48, 256), dtype="<f8", chunks=(1, 48, 256)), "float64"),
    "flat echoes": (replaced("records/echo", shape=(48, 256), dtype="<i2", chunks=(48, 256)), "shape"),
    "fewer echoes": (replaced("records/echo", shape=(1, 40, 256), dtype="<i2", chunks=(1, 40, 256)), "shape"),
    "echoes in one piece": (replaced("records/echo", shape=(1, 48, 256), dtype="<i2"), "in one piece"),
    "huge echoes": (replaced("records/echo", shape=HUGE, dtype="<i2", chunks=(1, 1, 10_000_000)), "shape"),
    "huge chunks": (replaced("records/echo", shape=(1, 48, 256), dtype="<i2", chunks=(1, 48, 256)), ""),
    "a bomb": (
        replaced("records/echo", shape=(1, 48, 256), dtype="<i2", chunks=(1, 48, 256), compression=9),
        "filters",
    ),
    "a scene of numbers": (replaced("scene", shape=(), dtype="<f8"), "is not text"),
    "a list of scenes": (replaced("scene", shape=(7,), dtype="S9"), "not a single text"),
    "a huge scene": (replaced("scene", data=fixed_length("x" * 3_000_000)), "more than 1000000"),
    "a scene of any length": (replaced("scene", data="x"), "variable length"),
    "a huge place for a scene": (replaced("scene", shape=(), dtype="S2000000000"), "more than 1000000"),
    "a scene that is no TOML": (scene_with("[tracking]", "[tracking"), "not valid TOML"),
    "a scene with another gate": (scene_with("record_samples = 256", "record_samples = 512"), "its scene asks"),
    "a scene with a gate outside": (scene_with("gate_length_m = 1.0e-3", "gate_length_m = 9e-3"), "the gate takes"),
    "a scene with an endless sweep": (scene_with("[acquisition]", "[acquisition]\nrepeats = 1000000"), "shots"),
    "run times of another type": (
        replaced("run_time/run_time_s", shape=(11,), dtype="S9"),
        "/run_time/run_time_s holds",
    ),
    "run times without end": (replaced("run_time/stage", shape=(1_000_000,), dtype="S16"), "has shape"),
    "run times that are none": (values("run_time/run_time_s", np.inf), ""),
    "truth that is absent": (lambda path: _delete(path, "truth"), "absent"),
    "settings that are no JSON": (values("snapshot", b"{" * 900), ""),
}


def _delete(path: Path, name: str) -> None:
    with h5py.File(path, "r+", libver=("v110", "v110")) as file:
        del file[name]


@pytest.mark.skipif(os.name == "nt", reason="one of the cases is a pipe")
@pytest.mark.parametrize("case", TAMPERED)
def test_a_tampered_run_file_is_refused_with_a_message_that_says_why(
    small: Path, case: str, page_without_pictures: None
) -> None:
    change, message = TAMPERED[case]
    change(small)
    if not message:
        # The damaged part is not needed: any outcome except a traceback.
        for read in (process, read_snapshots, render):
            _outcome(partial(read, small))
        return
    with pytest.raises(MESSAGES, match=message) as raised:
        process(small)
    assert "Try:" in str(raised.value)
    assert not LIBRARY_WORDS.search(str(raised.value))
    with pytest.raises(MESSAGES):
        prepare_resumption(small)


def test_records_that_were_never_written_take_no_memory(small: Path) -> None:
    """A small file declares 20 TB of echoes, consistently in all datasets."""
    scene_with("pulse_count = 48", "pulse_count = 1000000")(small)
    scene_with("record_samples = 256", "record_samples = 10000000\nsample_rate_hz = 100e6")(small)
    replace_dataset(small, "records/echo", shape=HUGE, dtype="<i2", chunks=(1, 1, 10_000_000), fillvalue=-32768)
    for name, dtype in (("recorded", "u1"), ("trigger_time_s", "<f8"), ("pulse_onset_s", "<f8")):
        replace_dataset(small, f"records/{name}", shape=HUGE[:2], dtype=dtype, chunks=(1, 65536), fillvalue=1)
    replace_dataset(small, "truth/displacement_m", shape=HUGE[:2], dtype="<f8", chunks=(1, 65536))
    with pytest.raises(MESSAGES, match="records"):
        process(small)
    with pytest.raises(StoreError, match="records"):
        read_run(small).records[0]


def _outcome(call: Callable[[], object]) -> str:
    try:
        call()
    except MESSAGES as error:
        assert not LIBRARY_WORDS.search(str(error)), error  # noqa: PT017
        return "message"
    return "success"


def mutated_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    """Return ``data`` cut short, or with bits, bytes or whole pieces changed."""
    mutated = bytearray(data)
    start, length = int(rng.integers(len(data))), int(rng.integers(1, 5000))
    match int(rng.integers(5)):
        case 0:
            del mutated[start:]
        case 1:
            for position in rng.integers(0, len(data), rng.integers(1, 20)):
                mutated[position] = rng.integers(256)
        case 2:
            for position in rng.integers(0, 9000, rng.integers(1, 8)):
                mutated[position] ^= 1 << int(rng.integers(8))
        case 3:
            mutated[start : start + length] = bytes(length)
        case _:
            source = int(rng.integers(len(data)))
            mutated[start : start + length] = data[source : source + length]
    return bytes(mutated)


def outcomes_of(calls: Iterator[tuple[str, Callable[[], object]]], folder: Path) -> dict[str, int]:
    """Make every call in a process with bounded memory and return the number of each outcome; fail on any other."""
    import resource

    (folder / "before").write_text("")
    outcomes: dict[str, int] = {}
    pid = os.fork()
    if pid == 0:
        code = 1
        try:
            base = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
            resource.setrlimit(resource.RLIMIT_AS, (base + MAX_BYTES, base + MAX_BYTES))
            for number, (name, call) in enumerate(calls):
                (folder / "before").write_text(f"{number}: {name}")
                start_s = time.process_time()
                outcome = _outcome(call)
                assert time.process_time() - start_s < MAX_S, "a hang"
                outcomes[outcome] = outcomes.get(outcome, 0) + 1
            (folder / "after").write_text(repr(outcomes))
            code = 0
        except BaseException:
            import traceback

            (folder / "after").write_text(traceback.format_exc())
        finally:
            os._exit(code)
    _, status = os.waitpid(pid, 0)
    code = os.waitstatus_to_exitcode(status)
    after = (folder / "after").read_text() if (folder / "after").exists() else ""
    assert code == 0, f"exit {code} at case {(folder / 'before').read_text()}\n{after}"
    counts: dict[str, int] = eval(after)
    return counts


@needs_linux
@pytest.mark.parametrize("cases", [12, pytest.param(4000, marks=pytest.mark.slow)])
def test_mutated_run_files_end_in_a_result_or_a_message(small: Path, tmp_path: Path, cases: int) -> None:
    data, rng = small.read_bytes(), np.random.default_rng(5)
    fuzzed = tmp_path / "fuzzed.h5"

    def calls() -> Iterator[tuple[str, Callable[[], object]]]:
        for _ in range(cases):
            fuzzed.write_bytes(mutated_bytes(data, rng))
            fuzzed.with_name("fuzzed.coherent.h5").unlink(missing_ok=True)
            yield "run", lambda: (read_snapshots(fuzzed), process(fuzzed))

    outcomes = outcomes_of(calls(), tmp_path)
    assert sum(outcomes.values()) == cases
    # Most changes are detected by HDF5's own checksums; some bytes have no effect. Without both outcomes the test would
    # test nothing.
    assert outcomes["success"] >= cases // 30
    assert outcomes["message"] >= cases // 5


VALUES = (0, -1, 2**31, 2**63, 2**64, 10**30, -0.0, 1e-300, 1e300, np.nan, np.inf, "", " ", "x", "nan", "\u202e\u2066")


def changed_file(path: Path, rng: np.random.Generator) -> str:
    """Change one attribute or dataset of a run file: its value, its type, its shape, its place; return what."""
    with h5py.File(path, "r+", libver=("v110", "v110")) as file:
        datasets: list[str] = []
        file.visititems(lambda name, item: datasets.append(name) if isinstance(item, h5py.Dataset) else None)
        name = datasets[int(rng.integers(len(datasets)))]
        owner = file if rng.random() < 0.3 else file[name]
        value: Any = [*VALUES, np.arange(3), np.zeros((2, 2)), np.float32(1), True]
        value = value[int(rng.integers(len(value)))]
        if isinstance(value, str):
            value = np.array(value.encode(), dtype=h5py.string_dtype("utf-8", max(1, len(value.encode()))))
        kind = int(rng.integers(5))
        if kind < 2 and len(owner.attrs):
            key = list(owner.attrs)[int(rng.integers(len(owner.attrs)))]
            with suppress(TypeError, ValueError, OverflowError, OSError):
                owner.attrs[key] = value
            return f"attribute {key} of {owner.name}: {value!r}"
        if kind == 2:
            del file[name]
        elif kind == 3 and file[name].shape != () and file[name].dtype.kind in "iuf":
            with suppress(TypeError, ValueError, OverflowError, OSError):
                file[name][(int(rng.integers(file[name].shape[0])), ...)] = value
        else:
            del file[name]
            with suppress(TypeError, ValueError, OverflowError):
                file[name] = value
        return f"{name}: {('deleted', 'values', 'replaced')[kind - 2] if kind > 1 else 'replaced'} {value!r}"


@needs_linux
@pytest.mark.parametrize("cases", [9, pytest.param(2000, marks=pytest.mark.slow)])
def test_changed_datasets_and_attributes_end_in_a_run_or_a_message(intact: Path, tmp_path: Path, cases: int) -> None:
    rng, data, path = np.random.default_rng(9), intact.read_bytes(), tmp_path / "run.h5"

    def calls() -> Iterator[tuple[str, Callable[[], object]]]:
        for _ in range(cases):
            path.write_bytes(data)
            yield changed_file(path, rng), lambda: (open_run(path).records[0], read_snapshots(path))

    found = outcomes_of(calls(), tmp_path)
    assert found["message"] >= cases // 3


@needs_linux
@pytest.mark.parametrize("cases", [2, pytest.param(1000, marks=pytest.mark.slow)])
def test_whatever_stands_beside_a_run_file_is_no_traceback(intact: Path, tmp_path: Path, cases: int) -> None:
    rng, run, path = np.random.default_rng(10), intact.read_bytes(), tmp_path / "run.h5"
    beside = {file.name: file.read_bytes() for file in intact.parent.glob("run.*") if file != intact}
    beside |= {"run.h5.stop": b"", "run.h5.lock": b"", "run.log": b"x\n"}

    def calls() -> Iterator[tuple[str, Callable[[], object]]]:
        for _ in range(cases):
            name = sorted(beside)[int(rng.integers(len(beside)))]
            content = bytearray(beside[name])
            for _ in range(int(rng.integers(1, 30))):
                content[int(rng.integers(len(content) + 1)) :] = rng.bytes(int(rng.integers(0, 40)))
            path.write_bytes(run)
            (tmp_path / name).write_bytes(content)
            # A result that is damaged is replaced; a run that has ended cannot be asked to stop.
            yield f"{name} {bytes(content)[:200]!r}", partial(process, path)
            yield f"{name} {bytes(content)[:200]!r}", partial(request_stop, path)

    outcomes_of(calls(), tmp_path)
