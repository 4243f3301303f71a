"""The live page's server without a browser: who may look, what they see, and that none holds up another."""

from __future__ import annotations

import http.client
import json
import math
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from typer.testing import CliRunner
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect

from hpe_rig.cli.app import app
from hpe_rig.cli.options import WatchOptions
from hpe_rig.cli.watch import supervise
from hpe_rig.live import history, server
from hpe_rig.live.server import LivePage
from hpe_rig.live.source import RunSource, Source
from hpe_rig.live.state import State
from hpe_rig.measurement.requests import StopRequested, pause_path, wait_for_move
from hpe_rig.measurement.run import record_run
from hpe_rig.measurement.sequencer import Progress, Step
from hpe_rig.measurement.setup import prepare, prepare_text
from hpe_rig.runs.run import process
from hpe_rig.scene import load_scene, scene_text
from hpe_rig.store import StoreError, WriteOptions, read_run


class Counter:
    """A source whose state is a count, and large: what a slow viewer chokes on."""

    def __init__(self) -> None:
        self.count = 0
        self.stopped = False

    def poll(self) -> State:
        self.count += 1
        return {"status": "running", "count": self.count, "bulk": "x" * 300_000}

    def stop(self) -> None:
        self.stopped = True


@pytest.fixture(scope="module")
def run_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_run(prepare("table-1"), tmp_path_factory.mktemp("live") / "run.h5")


@pytest.fixture
def counter() -> Counter:
    return Counter()


@contextmanager
def served(source: Source) -> Iterator[LivePage]:
    """Yield the live page of ``source``, which a thread serves."""
    page = LivePage(source)
    thread = threading.Thread(target=page.serve, daemon=True)
    thread.start()
    try:
        yield page
    finally:
        page.close()
        thread.join(10)
        assert not thread.is_alive()


@pytest.fixture
def page(counter: Counter) -> Iterator[LivePage]:
    with served(counter) as page:
        yield page


def asked(page: LivePage, path: str, method: str = "GET", **headers: str) -> tuple[int, dict[str, str], str]:
    parts = urlsplit(page.address)
    assert parts.hostname == "127.0.0.1"
    connection = http.client.HTTPConnection("127.0.0.1", parts.port or 0, timeout=10)
    connection.request(method, path, headers=headers)
    reply = connection.getresponse()
    text = reply.read().decode()
    connection.close()
    return reply.status, {name.lower(): value for name, value in reply.getheaders()}, text


def watch(page: LivePage) -> str:
    return page.address.replace("http:", "ws:") + "ws"


def test_the_page_is_there_for_whoever_has_the_address_and_for_nobody_else(page: LivePage) -> None:
    base = urlsplit(page.address).path
    status, headers, text = asked(page, base)
    assert status == 200
    assert "Stop safely" in text
    assert "@NONCE@" not in text
    policy = headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert headers["cache-control"] == "no-store"
    assert len(base) > 32
    for path in ("/", "/stop", "/ws", "/" + "a" * (len(base) - 2) + "/"):
        assert asked(page, path)[0] == 404
    for path in (base, base + "state"):
        assert asked(page, path, Host="evil.example")[0] == 403
    assert asked(page, base + "stop", "POST", Origin="http://evil.example")[0] == 403


def test_two_pages_have_different_addresses() -> None:
    pages = [LivePage(Counter()) for _ in range(2)]
    tokens = {urlsplit(page.address).path for page in pages}
    assert len(tokens) == 2
    for page in pages:
        page.close()


def test_a_port_that_is_taken_is_refused_with_a_message(page: LivePage) -> None:
    port = urlsplit(page.address).port
    assert port is not None
    with pytest.raises(StoreError, match=rf"port {port} cannot be used"):
        LivePage(Counter(), port)


def test_a_foreign_page_cannot_watch(page: LivePage) -> None:
    with pytest.raises(InvalidStatus, match="403"), connect(watch(page), origin="http://evil.example"):
        pass


def half_open(page: LivePage, start: bytes) -> socket.socket:
    """Return a connection that has sent the ``start`` of a request and sends no more."""
    connection = socket.create_connection(("127.0.0.1", urlsplit(page.address).port or 0), timeout=10)
    connection.sendall(start)
    return connection


def is_ended(connection: socket.socket) -> bool:
    """Wait until the other end is gone; raises ``TimeoutError`` where it stays for ten seconds."""
    with connection, suppress(ConnectionError):
        return connection.recv(1000) == b""
    return True


WHOLE = b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n"


LONG = b"GET / HTTP/1.1\r\nHost: localhost\r\nA: " + b"b" * 5000


@pytest.mark.parametrize(
    ("start", "request_s"),
    [
        *((each, 0.3) for each in (b"GET / HT", b"", WHOLE[:-2], LONG)),
        *(pytest.param(each, None, marks=pytest.mark.slow) for each in (b"GET / HT", b"", WHOLE[:-2], LONG)),
    ],
)
def test_a_half_open_request_is_ended_within_ten_seconds(
    page: LivePage, monkeypatch: pytest.MonkeyPatch, start: bytes, request_s: float | None
) -> None:
    assert server.REQUEST_TIMEOUT_S + 2 * server.CHECK_PERIOD_S < 10
    if request_s:
        monkeypatch.setattr(server, "REQUEST_TIMEOUT_S", request_s)
        monkeypatch.setattr(server, "CHECK_PERIOD_S", 0.05)
    assert is_ended(half_open(page, start))


def test_a_second_request_that_stays_half_open_is_ended_too(page: LivePage, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "REQUEST_TIMEOUT_S", 0.3)
    monkeypatch.setattr(server, "CHECK_PERIOD_S", 0.05)
    connection = half_open(page, WHOLE)
    reply = b""
    while not reply.partition(b"\r\n\r\n")[2]:
        reply += connection.recv(1000)
    assert reply.startswith(b"HTTP/1.1 404")
    connection.sendall(b"GET")
    assert is_ended(connection)


def test_a_viewer_stays_though_it_says_nothing(page: LivePage, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "REQUEST_TIMEOUT_S", 0.2)
    monkeypatch.setattr(server, "CHECK_PERIOD_S", 0.05)
    with connect(watch(page), max_size=None) as viewer:
        first = json.loads(viewer.recv(timeout=10))["count"]
        time.sleep(1.0)
        while json.loads(viewer.recv(timeout=10))["count"] < first + 3:
            pass


@pytest.mark.parametrize("start", [b"", b"GET / HT", WHOLE])
def test_connections_without_the_token_give_way_to_newer_ones_and_to_its_holder(
    page: LivePage, counter: Counter, start: bytes
) -> None:
    base = urlsplit(page.address).path
    with connect(watch(page), max_size=None) as viewer, ExitStack() as stack:
        strangers = [stack.enter_context(half_open(page, start)) for _ in range(200)]
        # Long before the time limit of a request.
        start_s = time.monotonic()
        assert asked(page, base)[0] == 200
        assert asked(page, base + "stop", "POST")[0] == 200
        assert time.monotonic() - start_s < server.REQUEST_TIMEOUT_S / 2
        assert counter.stopped
        # The oldest are closed, and the viewer stays.
        with suppress(ConnectionError):
            while strangers[0].recv(1000):
                pass
        viewer.recv(timeout=10)


def test_the_number_of_viewers_is_limited_too(page: LivePage, monkeypatch: pytest.MonkeyPatch) -> None:
    with connect(watch(page), max_size=None) as viewer:
        viewer.recv(timeout=10)
        monkeypatch.setattr(server, "MAX_CONNECTIONS", 1)
        with pytest.raises(InvalidStatus, match="403"), connect(watch(page)):
            pass
        assert asked(page, urlsplit(page.address).path)[0] == 200


def test_stop_reaches_the_source(page: LivePage, counter: Counter) -> None:
    status, _, _ = asked(page, urlsplit(page.address).path + "stop", "POST")
    assert status == 200
    assert counter.stopped


def test_ten_viewers_see_news_while_one_of_them_never_reads(page: LivePage, counter: Counter) -> None:
    with ExitStack() as stack:
        deaf = stack.enter_context(connect(watch(page), max_size=None, max_queue=1, close_timeout=0.2))
        viewers = [stack.enter_context(connect(watch(page), max_size=None)) for _ in range(9)]
        first = [json.loads(viewer.recv(timeout=10))["count"] for viewer in viewers]
        deadline_s = time.monotonic() + 10
        while counter.count < max(first) + 5 and time.monotonic() < deadline_s:
            time.sleep(0.05)
        # states go on being read although one viewer has taken none
        assert counter.count >= max(first) + 5
        for viewer in viewers:
            last = 0
            while last < max(first) + 3:
                last = json.loads(viewer.recv(timeout=10))["count"]
        assert deaf.state.name == "OPEN"


def test_a_page_has_not_ended_before_every_complete_shot_is_estimated_and_leads_with_their_mean(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = load_scene("table-1").with_({"acquisition.repeats": 3, "tracking.pulse_count": 20})
    path = record_run(prepare_text("three", scene_text(scene)[1]), tmp_path / "run.h5")
    monkeypatch.setattr(history, "FINAL_UPDATE_TIME_S", 0.0)
    page = LivePage(RunSource(path))
    try:
        states = []
        for _ in range(4):
            states.append(json.loads(page._next() or "{}"))
            assert page._ended == (states[-1]["shots_pending"] == 0)
            if page._ended:
                break
    finally:
        page.close()
    pending = [state["shots_pending"] for state in states]
    assert pending[0] > 0
    assert pending[-1] == 0
    assert [len(state["over_shots"]) + state["shots_pending"] for state in states] == [3] * len(states)
    # A mean needs two shots.
    assert ["means" in state for state in states] == [len(state["over_shots"]) > 1 for state in states]
    (mean,), (harmonic,) = process(path).means, states[-1]["means"]
    assert (states[-1]["mean_of"], harmonic["hz"]) == (3, mean.frequency_hz)
    assert harmonic["nm"] == pytest.approx(mean.amplitude_m * 1e9, rel=1e-5)
    # The page has no ends of the gate in u, 1e-4 of the amplitude.
    assert harmonic["u_nm"] == pytest.approx(mean.amplitude_uncertainty_m * 1e9, rel=1e-3)
    assert harmonic["deg"] == pytest.approx(math.degrees(mean.phase_rad), rel=1e-5)
    assert states[-1]["harmonics"][0]["nm"] != harmonic["nm"]


def post(address: str, path: str) -> int:
    parts = urlsplit(address)
    connection = http.client.HTTPConnection("127.0.0.1", parts.port or 0, timeout=10)
    try:
        connection.request("POST", parts.path + path)
        return connection.getresponse().status
    finally:
        connection.close()


def test_the_page_of_a_run_that_goes_on_is_not_closed_from_the_browser(page: LivePage) -> None:
    assert post(page.address, "close") == 409


def test_the_page_stays_after_a_run_until_it_is_closed_and_the_address_serves_to_the_end(
    run_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A folder named like a package of ours does not keep it from starting.
    (tmp_path / "hpe_rig").mkdir()
    (tmp_path / "hpe_rig" / "__init__.py").write_text("raise SystemExit('somebody else s folder')", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PYTHONPATH", raising=False)
    said: list[str] = []

    def close_it() -> None:
        while not any("stays open" in text for text in said):
            time.sleep(0.02)
        address = said[0].removeprefix("live page: ")
        while post(address, "close") == 409:
            # its first state is being read
            time.sleep(0.05)

    closer = threading.Thread(target=close_it, daemon=True)
    with supervise(prepare("table-1"), run_file, read_run(run_file).run_id, WatchOptions(live=True), said.append):
        closer.start()
    closer.join(10)
    assert not closer.is_alive()


def states_until_the_run_ends(viewer: ClientConnection, title: str) -> list[State]:
    """Return the states that ``viewer`` receives up to the last one of the run with ``title``."""
    states: list[State] = []
    while not (states and states[-1].get("title") == title and states[-1].get("shots_pending") == 0):
        states.append(json.loads(viewer.recv(timeout=10)))
    return states


def test_the_page_of_a_replaced_file_is_that_of_the_new_run(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"

    def record(title: str, delay_s: float, repeats: int, pulses: int) -> None:
        scene = load_scene("table-1").with_(
            {
                "tracking.delay_s": delay_s,
                "acquisition.repeats": repeats,
                "tracking.pulse_count": pulses,
                "simulation.seed": repeats,
            }
        )
        setup = prepare_text(title, scene_text(scene)[1].replace("title = ", f'title = "{title}" # ', 1))
        record_run(setup, path, options=WriteOptions(overwrite=True))

    record("first", 0.13e-3, 1, 20)
    with served(RunSource(path)) as page:
        with connect(watch(page), max_size=None) as viewer:
            states = states_until_the_run_ends(viewer, "first")
            record("second", 0.15e-3, 2, 24)
            states += states_until_the_run_ends(viewer, "second")
        with connect(watch(page), max_size=None) as viewer:
            reloaded = json.loads(viewer.recv(timeout=10))
    # Estimates of many shots take several states.
    *_, fresh = iter(RunSource(path).poll, None)
    assert states[-1] == reloaded == json.loads(json.dumps(fresh))
    # A page reloads itself when this value changes.
    runs = {state["run"]: (state["title"], state["shots"]) for state in states if "run" in state}
    assert list(runs.values()) == [("first", 1), ("second", 2)]
    assert all((state["title"], state["shots"]) == runs[state["run"]] for state in states if "run" in state)


def test_the_command_refuses_a_file_that_is_no_run_file(tmp_path: Path) -> None:
    path = tmp_path / "first.toml"
    path.write_text(scene_text("table-1")[1], encoding="utf-8")
    done = CliRunner().invoke(app, ["live", str(path)])
    assert done.exit_code != 0
    assert "http" not in done.output
    assert "first.toml" in done.output


def test_a_place_that_cannot_be_asked_for_is_told_with_its_reason(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match=r"at 2 mm cannot be written beside .*No such file.*hpe-rig resume"):
        wait_for_move(tmp_path / "absent" / "run.h5", "one", 2e-3, lambda: False)


@contextmanager
def waiting_for_places(tmp_path: Path, ended: list[str]) -> Iterator[LivePage]:
    """Yield the page of a run over two places that waits for the transducer at each; ``ended`` says how it ended."""
    path, places = tmp_path / "run.h5", {"sweep.lateral_offset_m": [0.0, 2e-3], "tracking.pulse_count": 24}
    setup = prepare(load_scene("table-1").with_(places))

    def observe(progress: Progress) -> None:
        if progress.step is Step.MOVE:
            wait_for_move(path, "one", progress.shot.lateral_offset_m, lambda: False)

    def measure() -> None:
        try:
            record_run(setup, path, observe, options=WriteOptions(run_id="one"))
            ended.append("ended")
        except StopRequested:
            ended.append("stopped")

    run = threading.Thread(target=measure, daemon=True)
    run.start()
    with served(RunSource(path)) as page:
        try:
            yield page
        finally:
            run.join(30)
    assert not run.is_alive()
    assert not pause_path(path).exists()


def waits_for(page: LivePage, place_mm: float) -> None:
    deadline_s, base = time.monotonic() + 30, urlsplit(page.address).path
    while (state := json.loads(asked(page, base + "state")[2])).get("place_mm") != place_mm:
        assert time.monotonic() < deadline_s, state
        time.sleep(0.02)
    assert state["pause_requested"]


def test_a_run_that_waits_for_the_transducer_to_be_moved_goes_on_from_the_page(tmp_path: Path) -> None:
    ended: list[str] = []
    with waiting_for_places(tmp_path, ended) as page:
        # for the first of them before there is a run file
        for place_mm in (0.0, 2.0):
            waits_for(page, place_mm)
            assert post(page.address, "pause") == 200
    assert ended == ["ended"]
    # Only now: while the page has the file open in this process, HDF5 answers from what it read at its first opening.
    assert read_run(tmp_path / "run.h5").status == "complete"


@pytest.mark.slow
def test_a_run_that_waits_for_the_transducer_to_be_moved_can_be_stopped_from_the_page(tmp_path: Path) -> None:
    ended: list[str] = []
    with waiting_for_places(tmp_path, ended) as page:
        waits_for(page, 0.0)
        assert post(page.address, "pause") == 200
        waits_for(page, 2.0)
        assert post(page.address, "stop") == 200
    assert ended == ["stopped"]
    stored = read_run(tmp_path / "run.h5")
    assert stored.status == "aborted"
    assert stored.shot_complete.tolist() == [True, False]


@pytest.mark.slow
def test_a_run_without_report_and_page_loads_neither_drawing_nor_web_packages(tmp_path: Path) -> None:
    code = (
        "import sys\nfrom pathlib import Path\nfrom hpe_rig.measurement import record_run, prepare\n"
        "from hpe_rig.cli.app import app\n"
        "from hpe_rig.cli.options import WatchOptions\nfrom hpe_rig.cli.watch import supervise\n"
        "setup = prepare('table-1')\n"
        f"path = Path({str(tmp_path / 'run.h5')!r})\n"
        "with supervise(setup, path, '', WatchOptions(), print) as (watched, move):\n"
        "    record_run(setup, path, watched(lambda progress: None))\n"
        "print(*sorted({name.partition('.')[0] for name in sys.modules}))\n"
    )
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert not {"matplotlib", "jinja2", "starlette", "uvicorn", "websockets", "pandas", "xarray", "pyvisa"} & set(
        loaded.stdout.split()
    )
