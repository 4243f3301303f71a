"""Whatever kills a run, its file opens and holds what had come, and what is left can be measured.

The oracle is the same run left alone: the twin's records are a function of scene and shot.
"""

from __future__ import annotations

import itertools
import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.interfaces import RecordBlock
from hpe_rig.bench.instruments import Bench
from hpe_rig.bench.opening import open_bench
from hpe_rig.measurement import run as run_module
from hpe_rig.measurement.resumption import prepare_resumption, resume
from hpe_rig.measurement.run import record_run
from hpe_rig.measurement.sequencer import Progress, ShotBlock, Step, acquire
from hpe_rig.measurement.setup import Setup
from hpe_rig.runs.run import process
from hpe_rig.store import RunWriter, StoredRun, StoreError, WriteOptions, read_run

pytestmark = pytest.mark.skipif(os.name == "nt", reason="needs fork, SIGKILL and file size limits")

Prepare = Callable[..., Setup]
SWEEP = (
    ("burst_length_s = 100e-6", "burst_length_s = [50e-6, 100e-6]"),
    ("burst_count = 20", "burst_count = 6"),
    ("window_start_s = 50e-3", ""),
    ("[acquisition]", "[acquisition]\nrepeats = 2"),
)
ONE_LONG_SHOT = (
    ("[acquisition]", "[acquisition]\nrecord_samples = 8192"),
    ("snr_db = 40.0", ""),
    ("pulse_count = 101", "pulse_count = 400"),
)


def table(path: Path) -> dict[str, Any]:
    """Return everything a result says but its file's name and the time it took."""
    result = process(path).as_dict()
    return {key: value for key, value in result.items() if key not in ("run_file", "run_time_s")}


def forked(child: Callable[[], object]) -> int:
    """Run ``child`` in a process of its own, with everything already imported, and return its id."""
    pid = os.fork()
    if pid:
        return pid
    code = 1
    try:
        child()
        code = 0
    finally:
        # No clean-up: what a killed process would not have done must not be done here either.
        os._exit(code)


def blocks_of_the_first_shot(setup: Setup) -> list[RecordBlock]:
    """Return what the digitizer delivers for one shot, to be written over and over."""
    first = replace(setup.plan, shots=setup.plan.shots[:1])
    with open_bench(setup.scene.scene, setup.bench.bench, setup.plan.roles) as bench:
        return [event.block for event in acquire(first, bench) if isinstance(event, ShotBlock)]


def assert_holds_what_it_says(stored: StoredRun, whole: StoredRun) -> int:
    """Assert that every record marked as there equals that of the whole run, and return how many there are."""
    count = 0
    for shot, complete in enumerate(stored.shot_complete):
        records, expected = stored.records[shot], whole.records[shot]
        valid = records.valid
        assert not complete or valid.all()
        np.testing.assert_array_equal(records.codes[valid], expected.codes[valid])
        np.testing.assert_array_equal(records.trigger_time_s[valid], expected.trigger_time_s[valid])
        count += int(valid.sum())
    return count


def assert_resumes_to(path: Path, expected: dict[str, Any], number: int) -> None:
    """Assert that the run that stopped in ``path`` is completed to ``expected``, unless it was complete."""
    done = path
    if not read_run(path).shot_complete.all():
        done = resume(prepare_resumption(path), path.with_name(f"resumed-{number}.h5"))
        assert read_run(done).predecessor == path.name
        assert read_run(done).status == "complete"
    found = table(done)
    # A run killed after its last record is complete but for the word; it says so.
    assert found == expected | {name: found[name] for name in ("status", "warnings")}


@pytest.fixture(scope="module")
def left_alone(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Setup], Path]:
    """Return a function that measures a scene to its end, once for all tests of it."""
    folder, done = tmp_path_factory.mktemp("whole"), dict[str, Path]()

    def measured(setup: Setup) -> Path:
        text = setup.scene.text
        if text not in done:
            done[text] = record_run(setup, folder / f"{len(done)}.h5")
        return done[text]

    return measured


def kill_at_random(setup: Setup, whole_path: Path, tmp_path: Path, kills: int, seed: int) -> None:
    """Kill a run at ``kills`` random moments and assert that nothing is lost."""
    whole, expected = read_run(whole_path), table(whole_path)
    start = time.perf_counter()
    os.waitpid(forked(partial(record_run, setup, tmp_path / "timed.h5")), 0)
    duration_s = time.perf_counter() - start
    rng = np.random.default_rng(seed)
    opened, records, resumed = 0, 0, 0
    for number, moment_s in enumerate(rng.uniform(0, duration_s, kills)):
        path = tmp_path / f"{number}.h5"
        pid = forked(partial(record_run, setup, path))
        time.sleep(moment_s)
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        if not path.exists():
            continue
        opened += 1
        stored = read_run(path)
        records += assert_holds_what_it_says(stored, whole)
        resumed += not stored.shot_complete.all()
        assert_resumes_to(path, expected, number)
        for old in (path, path.with_name(f"resumed-{number}.h5")):
            old.unlink(missing_ok=True)
    print(f"{kills} kills: {opened} files, {records} records, {resumed} resumed to the same table")
    assert opened > kills / 4


@pytest.mark.slow
@pytest.mark.parametrize("kills", [2, pytest.param(200, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    ("scene", "edits"),
    [pytest.param("table-1", ONE_LONG_SHOT, marks=pytest.mark.slow), ("bovine-muscle-synchronous", SWEEP)],
)
def test_a_run_killed_at_any_moment_opens_keeps_its_records_and_resumes_to_the_same_table(
    prepared: Prepare,
    left_alone: Callable[[Setup], Path],
    tmp_path: Path,
    scene: str,
    edits: tuple[tuple[str, str], ...],
    kills: int,
) -> None:
    setup = prepared(scene, *edits)
    kill_at_random(setup, left_alone(setup), tmp_path, kills, seed=1)


@pytest.mark.slow
@pytest.mark.parametrize("compress", [False, True], ids=["plain", "compressed"])
def test_a_writer_killed_in_the_middle_of_writing_leaves_whole_records(
    prepared: Prepare, tmp_path: Path, compress: bool
) -> None:
    # The same blocks over and over, cut small: nearly all the time is spent in writing, and so the kills fall there.
    kills, repeats = 400, 20
    acquisition = f"[acquisition]\nrepeats = {repeats}\nrecord_samples = 2048"
    setup = prepared("table-1", ("[acquisition]", acquisition), ("snr_db = 40.0", ""))
    blocks = blocks_of_the_first_shot(setup)
    codes = np.concatenate([block.codes for block in blocks])

    def write(path: Path) -> None:
        with RunWriter(path, setup.scene, setup.bench, setup.plan, WriteOptions(compress=compress)) as writer:
            for shot in setup.plan.shots:
                for block in blocks:
                    writer.append(shot, block)
                writer.finish(shot)

    start = time.perf_counter()
    os.waitpid(forked(partial(write, tmp_path / "whole.h5")), 0)
    duration_s = time.perf_counter() - start
    shots = []
    for number, moment_s in enumerate(np.random.default_rng(2).uniform(0, duration_s, kills)):
        path = tmp_path / f"{number}.h5"
        pid = forked(partial(write, path))
        time.sleep(moment_s)
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        if not path.exists():
            continue
        stored = read_run(path)
        for shot in range(int(stored.shot_complete.sum()) + 1):
            if shot < repeats:
                records = stored.records[shot]
                np.testing.assert_array_equal(records.codes[records.valid], codes[records.valid])
                assert records.valid.all() or not stored.shot_complete[shot]
        shots.append(int(stored.shot_complete.sum()))
        path.unlink()
    print(f"{kills} kills, {len(shots)} files with {min(shots)} to {max(shots)} of {repeats} shots")
    assert len(shots) > kills / 4


def measure_on_a_full_disk(setup: Setup, path: Path, size: int) -> None:
    """Measure with files that cannot grow beyond ``size`` and assert how it ends; for a process of its own."""
    import resource

    benches: list[Bench] = []

    @contextmanager
    def noted(*arguments: Any) -> Iterator[Bench]:
        with open_bench(*arguments) as bench:
            benches.append(bench)
            yield bench

    vars(run_module)["open_bench"] = noted
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
    with pytest.raises(StoreError, match="File too large") as raised:
        record_run(setup, path)
    assert path.name in str(raised.value)
    assert "Try:" in str(raised.value)
    for bench in benches:
        assert bench.world is not None
        assert not any(bench.world.outputs_on().values())
        assert not bench.world.board.running


@pytest.mark.slow
@pytest.mark.parametrize("sizes", [1, pytest.param(50, marks=pytest.mark.slow)])
def test_a_disk_full_at_any_size_ends_with_a_message_outputs_off_and_a_file_that_resumes(
    prepared: Prepare, left_alone: Callable[[Setup], Path], tmp_path: Path, sizes: int
) -> None:
    setup = prepared("bovine-muscle-synchronous", *SWEEP)
    whole_path = left_alone(setup)
    whole, expected = read_run(whole_path), table(whole_path)
    opened, records = 0, 0
    # One in each of equal parts, so that a few sizes, too, meet the header and the records.
    shares = (np.arange(sizes) + np.random.default_rng(3).random(sizes)) / sizes
    for number, size in enumerate(0.97 * whole_path.stat().st_size * shares):
        path = tmp_path / f"{number}.h5"
        pid = forked(partial(measure_on_a_full_disk, setup, path, int(size)))
        _, status = os.waitpid(pid, 0)
        assert os.waitstatus_to_exitcode(status) == 0
        if not path.exists():
            continue
        opened += 1
        stored = read_run(path)
        assert stored.status == "failed"
        records += assert_holds_what_it_says(stored, whole)
        assert_resumes_to(path, expected, number)
    print(f"{sizes} sizes: {opened} files, {records} records kept")
    assert opened
    assert not list(tmp_path.glob(".*draft"))


@pytest.mark.slow
def test_live_reading_while_writing_never_fails_and_never_sees_half_a_record(prepared: Prepare, tmp_path: Path) -> None:
    # Short records and pauses: the file stays small on a busy machine, and so does the time of a reading.
    reads_while_writing(prepared, tmp_path, reads=4, repeats=100, record_samples=256, pause_s=0.1)


@pytest.mark.slow
def test_a_thousand_live_reads_while_writing(prepared: Prepare, tmp_path: Path) -> None:
    reads_while_writing(prepared, tmp_path, reads=1000)


def reads_while_writing(
    prepared: Prepare,
    tmp_path: Path,
    reads: int,
    repeats: int = 400,
    record_samples: int = 1024,
    pause_s: float = 0.0,
) -> None:
    """Read a file ``reads`` times while another process writes it, with a pause after each shot."""
    acquisition = f"[acquisition]\nrepeats = {repeats}\nrecord_samples = {record_samples}"
    edits = (("[acquisition]", acquisition), ("snr_db = 40.0", ""))
    setup = prepared("table-1", *edits)
    blocks = blocks_of_the_first_shot(setup)
    codes = np.concatenate([block.codes for block in blocks])
    path = tmp_path / "live.h5"

    def write() -> None:
        with RunWriter(path, setup.scene, setup.bench, setup.plan) as writer:
            for shot in itertools.cycle(setup.plan.shots):
                for block in blocks:
                    writer.append(shot, block)
                writer.finish(shot)
                time.sleep(pause_s)

    pid = forked(write)
    while not path.exists():
        time.sleep(0.001)
    counts, rng = list[int](), np.random.default_rng(4)
    # A busy machine may give the writer no turn for a while: reading goes on until it has grown.
    patience_s = time.monotonic() + 20.0
    try:
        while len(counts) < reads or (len(set(counts)) <= 3 and time.monotonic() < patience_s):
            stored = read_run(path)
            assert stored.status == "running"
            complete = int(stored.shot_complete.sum())
            for shot in {min(complete, repeats - 1), int(rng.integers(0, complete + 1)) % repeats}:
                records = stored.records[shot]
                np.testing.assert_array_equal(records.codes[records.valid], codes[records.valid])
                assert np.isfinite(records.trigger_time_s[records.valid]).all()
            if counts and complete == counts[-1]:
                # The writer gets its turn on a busy machine.
                time.sleep(0.02)
            counts.append(complete)
    finally:
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
    print(f"{reads} reads while {counts[0]} grew to {counts[-1]} shots")
    assert counts == sorted(counts)
    assert len(set(counts)) > 3


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs Linux's account of memory")
def test_a_long_run_streams_in_constant_memory(prepared: Prepare, tmp_path: Path) -> None:
    edits = (("[acquisition]", "[acquisition]\nrepeats = 120\nrecord_samples = 10000"), ("snr_db = 40.0", ""))
    setup = prepared(
        "table-1",
        *edits,
        ("pulse_count = 101", "pulse_count = 500"),
        ("pulse_rate_hz = 4000.0", "pulse_rate_hz = 2000.0"),
    )
    report = tmp_path / "resident.txt"

    def noted() -> None:
        resident = []

        def observe(progress: Progress) -> None:
            if progress.step is Step.SAFE:
                pages = int(Path("/proc/self/statm").read_text().split()[1])
                resident.append(pages * os.sysconf("SC_PAGE_SIZE") / 1e6)
                report.write_text(" ".join(f"{megabytes:.1f}" for megabytes in resident))

        record_run(setup, tmp_path / "run.h5", observe)

    _, status = os.waitpid(forked(noted), 0)
    assert os.waitstatus_to_exitcode(status) == 0
    resident = [float(word) for word in report.read_text().split()]
    written = (tmp_path / "run.h5").stat().st_size / 1e6
    print(f"{written:.0f} MB written, resident {resident[0]:.0f}, {resident[60]:.0f}, {resident[-1]:.0f} MB")
    assert written > 1200
    assert max(resident) < 500
    # One shot is 10 MB on disk and 40 MB in the twin: less than one of them may stay of sixty. What waits for the disk
    # comes and goes.
    assert max(resident[60:]) - max(resident[:60]) < 10
