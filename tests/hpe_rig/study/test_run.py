"""Studies as runs: resumed, interrupted, with workers lost, on one process, two, or a cluster: the same numbers."""

from __future__ import annotations

import functools
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from hpe_rig.cli.app import app
from hpe_rig.scene import SettingsError
from hpe_rig.store import StoreError
from hpe_rig.study.definition import Definition
from hpe_rig.study.executor import (
    MAX_LOSSES,
    NO_TLS,
    TlsFiles,
    cluster,
    completed,
    processes,
    untrusted_network,
)
from hpe_rig.study.results import FIELDS, CaseStore, StudyResult
from hpe_rig.study.run import run_study

STUDY = """
title = "a small study"
scene = "table-1"
scatterers = 16
[set]
"tracking.pulse_count" = 40
[[axes]]
name = "D_0"
keys = { "simulation.motion[0].amplitude_m" = [0.5e-6, 1e-6, 2e-6] }
[[axes]]
name = "SNR"
keys = { "simulation.receiver.snr_db" = [10.0, 30.0] }
"""
OF_THE_RUN = ("seconds", "peak_memory_bytes")


@pytest.fixture
def study(tmp_path: Path) -> str:
    path = tmp_path / "small.toml"
    path.write_text(STUDY, encoding="utf-8")
    return str(path)


@contextmanager
def threads() -> Iterator[Executor]:
    with ThreadPoolExecutor(1) as pool:
        yield pool


def numbers(results: list[StudyResult]) -> list[dict[str, Any]]:
    """Return what must not hang on when and where a case was computed; NaN as text, for it equals nothing."""
    return [
        json.loads(json.dumps({key: value for key, value in row.items() if key not in OF_THE_RUN}), parse_constant=str)
        for result in results
        for row in result.rows
    ]


def read_study(folder: Path) -> StudyResult:
    """Return a finished study from its file."""
    tables = json.loads((folder / "study.json").read_text(encoding="utf-8"))
    definition = Definition.model_validate(tables["definition"])
    return StudyResult(tables["name"], definition, tables["rows"], tuple(tables["versions"]))


def test_results_read_back_and_stand_in_the_table(study: str, tmp_path: Path) -> None:
    (result,) = run_study(study, tmp_path / "out", threads)
    assert len(result.rows) == 3 * 2 * 2
    assert [(row["D_0"], row["SNR"]) for row in result.rows[::2]] == [
        (amplitude, snr) for amplitude in (0.5e-6, 1e-6, 2e-6) for snr in (10.0, 30.0)
    ]
    assert result.realisations == 6 * 32
    again = read_study(tmp_path / "out" / "small")
    assert numbers([again]) == numbers([result])
    assert again.definition == result.definition
    lines = (tmp_path / "out" / "small" / "summary.csv").read_text(encoding="utf-8").splitlines()
    assert lines[0].startswith("D_0,SNR,reading,estimator,frequency_hz,amplitude_true_m,amplitude_bias_m")
    assert len(lines) == 1 + len(result.rows)
    assert len(list((tmp_path / "out" / "cases").rglob("*.json"))) == 6


def test_an_interrupted_study_continues_where_it_stopped(study: str, tmp_path: Path) -> None:
    whole = run_study(study, tmp_path / "whole", threads)

    def interrupt(done: int, total: int) -> None:
        if done >= total / 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as caught:
        run_study(study, tmp_path / "out", threads, ahead=1, watch=interrupt)
    kept = len(list((tmp_path / "out" / "cases").rglob("*.json")))
    assert 3 <= kept < 6
    assert f"{kept} of 6 cases are stored" in caught.value.__notes__[0]
    told: list[tuple[int, int]] = []
    rest = run_study(study, tmp_path / "out", threads, watch=lambda done, total: told.append((done, total)))
    assert told[0] == (0, (6 - kept) * 32)
    assert numbers(rest) == numbers(whole)


def test_a_damaged_file_of_a_case_is_computed_again(study: str, tmp_path: Path) -> None:
    whole = run_study(study, tmp_path / "out", threads)
    first, second, third, *_ = sorted((tmp_path / "out" / "cases").rglob("*.json"))
    first.write_text(first.read_text(encoding="utf-8")[:100], encoding="utf-8")
    second.write_text("[]", encoding="utf-8")
    third.write_text(json.dumps({"case": third.stem}), encoding="utf-8")
    assert numbers(run_study(study, tmp_path / "out", threads)) == numbers(whole)


def test_a_single_changed_digit_of_a_case_is_found_told_of_and_computed_again(study: str, tmp_path: Path) -> None:
    whole = run_study(study, tmp_path / "out", threads)
    paths = sorted((tmp_path / "out" / "cases").rglob("*.json"))
    for path in paths[:3]:
        text = path.read_text(encoding="utf-8")
        value = json.loads(text)["record"]["estimates"][0]["amplitude_jitter_m"]
        path.write_text(text.replace(repr(value), repr(1.25 * value)), encoding="utf-8")
    told: list[str] = []
    again = run_study(study, tmp_path / "out", threads, tell=told.append)
    assert numbers(again) == numbers(whole)
    assert told == [
        f"3 case files in {tmp_path / 'out' / 'cases'} are damaged or have no checksum: computing them again"
    ]
    assert run_study(study, tmp_path / "out", threads, tell=told.append)
    assert len(told) == 1


@pytest.mark.parametrize("address", ["tcp://10.0.0.5:8786", "tcp://cluster.example:8786", "[::2]:8786"])
def test_a_scheduler_without_tls_is_told_of(address: str) -> None:
    assert "trusted networks only" in untrusted_network(address)


@pytest.mark.parametrize("address", ["local", "tls://10.0.0.5:8786", "tcp://127.0.0.1:8786", "tcp://[::1]:8786"])
def test_a_scheduler_that_nobody_else_reaches_is_not(address: str) -> None:
    assert not untrusted_network(address)


def test_files_of_tls_are_all_there_or_none(tmp_path: Path) -> None:
    (tmp_path / "ca.pem").write_text("", encoding="ascii")
    assert not NO_TLS.mistakes()
    found = TlsFiles(ca=tmp_path / "ca.pem", cert=tmp_path / "no.pem").mistakes()
    assert [mistake.path for mistake in found] == ["--tls-cert", "--tls-key"]


def test_a_finished_study_computes_nothing(study: str, tmp_path: Path) -> None:
    run_study(study, tmp_path / "out", threads)

    def never() -> Any:
        raise AssertionError("a pool was opened")

    assert len(run_study(study, tmp_path / "out", never)) == 1


class Dying(Executor):
    """An executor whose worker dies at some of its pieces, as a killed process does."""

    def __init__(self, dies: Callable[[], bool]) -> None:
        self._dies = dies

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        if self._dies():
            future.set_exception(BrokenExecutor("killed"))
        else:
            future.set_result(fn(*args, **kwargs))
        return future


def test_a_lost_worker_costs_its_piece_alone() -> None:
    deaths = iter([False, True, False, False, True])
    ran: list[int] = []

    def run(piece: int) -> int:
        ran.append(piece)
        return piece * piece

    @contextmanager
    def pool() -> Iterator[Executor]:
        yield Dying(lambda: next(deaths, False))

    assert sorted(completed(pool, run, range(6), 1)) == [0, 1, 4, 9, 16, 25]
    assert sorted(ran) == [0, 1, 2, 3, 4, 5]


def test_losses_with_pieces_finished_between_end_nothing() -> None:
    deaths = iter([True, False] * (MAX_LOSSES + 1))

    @contextmanager
    def pool() -> Iterator[Executor]:
        yield Dying(lambda: next(deaths))

    assert list(completed(pool, abs, range(MAX_LOSSES + 1), 1)) == list(range(MAX_LOSSES + 1))


def test_workers_that_always_die_end_the_study_with_a_word(study: str, tmp_path: Path) -> None:
    opened = []

    @contextmanager
    def pool() -> Iterator[Executor]:
        opened.append(1)
        yield Dying(lambda: True)

    with pytest.raises(SettingsError, match=f"died {MAX_LOSSES} times in succession"):
        run_study(study, tmp_path / "out", pool)
    assert len(opened) == MAX_LOSSES


def test_a_fault_of_the_work_is_not_taken_for_a_lost_worker() -> None:
    def fail(piece: int) -> int:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        list(completed(threads, fail, [1], 1))


def test_the_command_names_its_results_and_a_mistake(study: str, tmp_path: Path) -> None:
    run_study(study, tmp_path / "out", threads)
    shown = CliRunner().invoke(app, ["study", study, "--output", str(tmp_path / "out")])
    assert shown.exit_code == 0, shown.output
    assert "small" in shown.output
    assert "192" in shown.output
    wrong = CliRunner().invoke(app, ["study", "fig-99", "--output", str(tmp_path / "out")])
    assert wrong.exit_code == 2
    assert "no shipped study and no file" in wrong.output
    many = CliRunner().invoke(app, ["study", study, "--noise", "0", "--output", str(tmp_path / "out")])
    assert many.exit_code == 2
    assert "noise: 0 is out of bounds" in many.output


def test_a_folder_that_cannot_be_written_is_told(study: str, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    with pytest.raises(StoreError, match="cannot be written"):
        run_study(study, tmp_path / "file" / "out", threads)


def test_a_case_whose_file_cannot_be_put_in_place_leaves_nothing(tmp_path: Path) -> None:
    record = dict.fromkeys(FIELDS, 0) | {"case": "abc"}
    (tmp_path / "ab" / "abc.json" / "in the way").mkdir(parents=True)
    with pytest.raises(StoreError, match="cannot be written"):
        CaseStore(tmp_path).write(record)
    assert [path.name for path in (tmp_path / "ab").iterdir()] == ["abc.json"]


def test_no_axis_hides_a_column_of_the_results(study: str, tmp_path: Path) -> None:
    (result,) = run_study(study, tmp_path / "out", threads)
    for column in result.rows[0].keys() - {"D_0", "SNR"}:
        with pytest.raises(ValueError, match="columns of every result"):
            Definition.model_validate({"title": "x", "scene": "table-1", "axes": [AXIS | {"name": column}]})


AXIS = {"keys": {"simulation.receiver.snr_db": [10.0]}}


def _larger(tmp_path: Path) -> str:
    path = tmp_path / "small.toml"
    path.write_text(STUDY.replace("scatterers = 16", "scatterers = 320"), encoding="utf-8")
    return str(path)


@pytest.mark.slow
def test_one_worker_and_two_give_the_same_bits(study: str, tmp_path: Path) -> None:
    one, two = (run_study(study, tmp_path / str(count), functools.partial(processes, count), 4) for count in (1, 2))
    assert numbers(one) == numbers(two)


def _kill_one_when(pids: Callable[[], list[int]]) -> Callable[[int, int], None]:
    killed: list[int] = []

    def watch(done: int, total: int) -> None:
        if done and not killed:
            killed.append(pids()[0])
            os.kill(killed[0], signal.SIGKILL)

    return watch


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="kills a process the POSIX way")
def test_a_killed_process_changes_nothing(tmp_path: Path) -> None:
    study = _larger(tmp_path)
    whole = run_study(study, tmp_path / "whole", functools.partial(processes, 1))
    pools: list[Any] = []

    @contextmanager
    def watched() -> Iterator[Executor]:
        with processes(2) as pool:
            pools.append(pool)
            yield pool

    watch = _kill_one_when(lambda: list(pools[-1]._processes))
    assert numbers(run_study(study, tmp_path / "out", watched, 3, watch=watch)) == numbers(whole)
    assert len(pools) == 2


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="kills a process the POSIX way")
@pytest.mark.filterwarnings("ignore")
def test_a_killed_worker_of_a_dask_cluster_changes_nothing(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    study = _larger(tmp_path)
    whole = run_study(study, tmp_path / "whole", functools.partial(processes, 1))

    def workers() -> list[int]:
        return list(distributed.default_client().run(os.getpid).values())

    found = run_study(study, tmp_path / "out", functools.partial(cluster, "local", 2), 3, watch=_kill_one_when(workers))
    assert numbers(found) == numbers(whole)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_local_dask_cluster_has_the_workers_asked_for_which_keep_freed_memory_and_are_not_profiled() -> None:
    distributed = pytest.importorskip("distributed")

    def settings() -> tuple[bool, int]:
        import dask

        return dask.config.get("distributed.worker.profile.enabled"), int(os.environ["MALLOC_TRIM_THRESHOLD_"])

    with cluster("local", 1):
        # Dask's defaults are a worker for each core, a profiler, and 65536 bytes.
        assert list(distributed.default_client().run(settings).values()) == [(False, 2**30)]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="interrupts the POSIX way")
@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_ends_cleanly_and_the_same_command_continues(sent: signal.Signals, tmp_path: Path) -> None:
    study = _larger(tmp_path)
    command = [sys.executable, "-m", "hpe_rig", "study", study, "--workers", "1", "--output", str(tmp_path / "out")]
    running = subprocess.Popen(
        command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True, text=True
    )
    while not list((tmp_path / "out").rglob("*.json")):
        assert running.poll() is None, running.communicate()
        time.sleep(0.05)
    os.killpg(running.pid, sent) if sent == signal.SIGINT else running.send_signal(sent)
    _, told = running.communicate(timeout=60)
    assert running.returncode == {signal.SIGINT: 130, signal.SIGTERM: 143}[sent], told
    assert "of 6 cases are stored" in told
    assert "Traceback" not in told
    again = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert again.returncode == 0, again.stderr
    whole = run_study(study, tmp_path / "whole", functools.partial(processes, 1))
    assert numbers([read_study(tmp_path / "out" / "small")]) == numbers(whole)
