"""Live page and report in headless Chromium: Debian's package, driven by playwright (extra browser); -m external."""

from __future__ import annotations

import os
import re
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from hpe_rig.measurement.requests import StopRequested
from hpe_rig.measurement.run import record_run
from hpe_rig.measurement.sequencer import Progress
from hpe_rig.measurement.setup import prepare, prepare_text
from hpe_rig.report.page import write_report
from hpe_rig.scene import shipped_scenes
from hpe_rig.store import WriteOptions, read_run

FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]

pytestmark = [pytest.mark.external, pytest.mark.filterwarnings("default")]


@pytest.fixture
def running(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[str], str, Path]]:
    """Yield a long sweep that runs with its live page: process, address, run file."""
    text = shipped_scenes()["bovine-muscle"]
    text = text.replace("burst_count = 20", "burst_count = 20\nforce_fraction = [0.25, 0.5, 1.0]")
    (tmp_path / "long.toml").write_text(text.replace("[acquisition]", "[acquisition]\nrepeats = 300"))
    command = [sys.executable, "-m", "hpe_rig", "run", "long.toml", "--live"]
    run = subprocess.Popen(
        command, cwd=tmp_path, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert run.stderr is not None
    first = run.stderr.readline()
    found = re.search(r"http://127\.0\.0\.1:\d+/\S+/", first)
    assert found, first
    try:
        yield run, found.group(), tmp_path / "long.h5"
    finally:
        run.terminate()
        run.communicate(timeout=30)


@pytest.fixture(scope="module")
def browser() -> Iterator[object]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        yield chromium
        chromium.close()


def first_paint_ms(page: object) -> float:
    paints = "performance.getEntriesByType('paint').map(entry => entry.startTime)"
    # Waiting inside the page would evaluate text there, which its policy forbids.
    deadline_s = time.monotonic() + 30
    while not (found := page.evaluate(paints)) and time.monotonic() < deadline_s:  # type: ignore[attr-defined]
        page.wait_for_timeout(20)  # type: ignore[attr-defined]
    return float(found[0])


def shots(page: object) -> int:
    words = page.inner_text("#status")  # type: ignore[attr-defined]
    found = re.match(r"shot (\d+) of", words)
    return int(found.group(1)) if found else 0


def wait_for_shot(page: object, shot: int) -> None:
    deadline_s = time.monotonic() + 60
    while shots(page) < shot and time.monotonic() < deadline_s:
        page.wait_for_timeout(100)  # type: ignore[attr-defined]
    assert shots(page) >= shot


def test_it_opens_updates_survives_a_reload_serves_ten_viewers_and_stops_with_outputs_off(
    running: tuple[subprocess.Popen[str], str, Path], browser: object, tmp_path: Path
) -> None:
    run, address, run_file = running
    errors: list[str] = []
    pages = [browser.new_page(viewport={"width": 1280, "height": 900}) for _ in range(10)]  # type: ignore[attr-defined]
    for page in pages:
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
        page.goto(address)
    paint_ms = first_paint_ms(pages[0])
    for page in pages:
        wait_for_shot(page, 3)
    before = shots(pages[0])
    pages[0].reload()
    wait_for_shot(pages[0], before + 1)
    pages[0].wait_for_selector("#rows tr")
    assert pages[0].locator("#rows tr").count() == 10
    assert pages[0].inner_text("#source") == "SIMULATED"
    pages[0].screenshot(path=tmp_path / "live.png", full_page=True)
    pages[3].click("#stop")
    for page in pages:
        page.wait_for_selector("body[data-status=aborted]", timeout=30_000)
        assert "every output is off" in page.inner_text("#status")
    _, complaint = run.communicate(timeout=30)
    assert "stopped from the live page" in complaint
    assert "every output is off, verified" in complaint
    assert run.returncode == 130
    stored = read_run(run_file)
    assert stored.status == "aborted"
    assert stored.shot_complete[: before - 1].all()
    assert errors == []
    print(f"first paint after {paint_ms:.0f} ms")
    for page in pages:
        page.close()


@pytest.fixture
def started(tmp_path: Path) -> Iterator[Callable[..., tuple[subprocess.Popen[str], str]]]:
    """Yield what starts a command in an empty folder and returns the process and the address of its live page."""
    begun: list[subprocess.Popen[str]] = []

    def start(*words: str, **environment: str) -> tuple[subprocess.Popen[str], str]:
        run = subprocess.Popen(
            [sys.executable, "-m", "hpe_rig", *words], cwd=tmp_path, stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env={**os.environ, **environment},
        )  # fmt: skip
        begun.append(run)
        assert run.stdout is not None
        said = ""
        while not (found := re.search(r"http://127\.0\.0\.1:\d+/\S+/", said)):
            line = run.stdout.readline()
            assert line, said
            said += line
        return run, found.group()

    yield start
    for run in begun:
        if run.poll() is None:
            run.terminate()
        run.communicate(timeout=60)


def stopped_after_a_shot(path: Path) -> None:
    def stop(progress: Progress) -> None:
        if progress.shot.index == 1:
            raise StopRequested

    (path.parent / "two.toml").write_text(
        shipped_scenes()["table-1"].replace("[acquisition]", "[acquisition]\nrepeats = 2")
    )
    with pytest.raises(StopRequested):
        record_run(prepare(str(path.parent / "two.toml")), path, stop)


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])


def records(page: object) -> int:
    return int(page.evaluate("document.body.dataset.records"))  # type: ignore[attr-defined]


def test_the_page_of_a_short_run_stays_until_it_is_closed(
    browser: object, started: Callable[..., tuple[subprocess.Popen[str], str]]
) -> None:
    run, address = started("run", "table-1", "--live")
    page = browser.new_page(viewport={"width": 390, "height": 844})  # type: ignore[attr-defined]
    page.goto(address)
    page.wait_for_selector("body[data-status=complete]", timeout=60_000)
    page.reload()
    page.wait_for_selector("#close:not([hidden])", timeout=30_000)
    assert page.title() == "complete – table-1.h5"
    assert "every output is off" in page.inner_text("#status")
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert run.poll() is None
    page.click("#close")
    run.communicate(timeout=30)
    assert run.returncode == 0
    page.close()


def test_a_page_of_a_run_that_is_overwritten_shows_the_new_run_only(
    browser: object, started: Callable[..., tuple[subprocess.Popen[str], str]], tmp_path: Path
) -> None:
    def record(title: str, repeats: int) -> None:
        text = shipped_scenes()["table-1"].replace("title = ", f'title = "{title}" # ', 1)
        setup = prepare_text("scene", text.replace("[acquisition]", f"[acquisition]\nrepeats = {repeats}"))
        record_run(setup, tmp_path / "run.h5", options=WriteOptions(overwrite=True))

    record("first", 2)
    _, address = started("live", "run.h5")
    open_page, new_page = (browser.new_page() for _ in range(2))  # type: ignore[attr-defined]
    open_page.goto(address)
    # The second run has no curve over shots.
    open_page.wait_for_selector("#over[aria-label*='of 2 shots']", timeout=60_000)
    record("second", 1)
    new_page.goto(address)
    for page in (open_page, new_page):
        page.wait_for_selector("#title:text-is('second')", timeout=60_000)
        page.wait_for_selector("body[data-status=complete]", timeout=60_000)
        page.wait_for_selector("#rows tr")
    charts = "[...document.querySelectorAll('[aria-label]')].map(chart => chart.ariaLabel)"
    assert open_page.inner_text("body") == new_page.inner_text("body")
    assert open_page.evaluate(charts) == new_page.evaluate(charts)
    for page in (open_page, new_page):
        page.close()


def test_a_phone_sees_where_the_run_is_and_pauses_it(
    browser: object, running: tuple[subprocess.Popen[str], str, Path]
) -> None:
    run, address, _ = running
    page = browser.new_page(viewport={"width": 390, "height": 844})  # type: ignore[attr-defined]
    page.goto(address)
    wait_for_shot(page, 6)
    page.wait_for_selector("#rows tr")
    assert re.fullmatch(r"\d+ % – long\.h5", page.title())
    assert re.search(r"shot \d+ of 900, \d+ of \d+ records, .* left", page.inner_text("#status"))
    assert "F0" in page.inner_text("#setting") or "force" in page.inner_text("#setting")
    over = page.get_attribute("#over", "aria-label") or ""
    assert re.search(r"Amplitudes of \d+ shots, the last: .* nm at 100 Hz, u ", over)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    page.click("#pause")
    page.wait_for_selector("#pause:text-is('Continue')", timeout=30_000)
    deadline_s, before = time.monotonic() + 60, -1
    while records(page) != before and time.monotonic() < deadline_s:
        before = records(page)
        page.wait_for_timeout(4000)
    assert records(page) == before
    page.click("#pause")
    wait_for_shot(page, shots(page) + 2)
    assert page.inner_text("#pause") == "Pause"
    page.click("#stop")
    page.wait_for_selector("body[data-status=aborted]", timeout=30_000)
    run.communicate(timeout=30)
    assert run.returncode == 130
    page.close()


def test_the_last_warning_is_shown(
    browser: object, started: Callable[..., tuple[subprocess.Popen[str], str]], tmp_path: Path
) -> None:
    text = shipped_scenes()["bovine-muscle"]
    (tmp_path / "clipped.toml").write_text(text.replace("[acquisition]", "[acquisition]\ninput_range_v = 0.1"))
    run, address = started("run", "clipped.toml", "--live")
    page = browser.new_page(viewport={"width": 390, "height": 844})  # type: ignore[attr-defined]
    page.goto(address)
    page.wait_for_selector("#warning:not([hidden])", timeout=60_000)
    assert "reaches full scale" in page.inner_text("#warning")
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    page.close()
    run.terminate()


@pytest.mark.parametrize(
    ("command", "of"), [("run", "table-1"), ("resume", "half.h5"), ("live", "half.h5"), ("align", "table-1")]
)
def test_open_and_port_are_heeded_by_every_command_that_has_a_page(
    started: Callable[..., tuple[subprocess.Popen[str], str]], tmp_path: Path, command: str, of: str
) -> None:
    if of.endswith(".h5"):
        stopped_after_a_shot(tmp_path / of)
    opener, port = tmp_path / "opener.py", free_port()
    opener.write_text("import pathlib, sys\npathlib.Path('opened.txt').write_text(sys.argv[1])\n")
    browser = f"{sys.executable} {opener} %s"
    _, address = started(command, of, "--port", str(port), "--open", BROWSER=browser)
    assert address.startswith(f"http://127.0.0.1:{port}/")
    deadline_s = time.monotonic() + 30
    while not (tmp_path / "opened.txt").exists() and time.monotonic() < deadline_s:
        time.sleep(0.1)
    assert (tmp_path / "opened.txt").read_text() == address


@pytest.mark.parametrize("band", ["10:80", "40:90"])
def test_an_alignment_shows_band_peak_and_clipping_on_a_phone(
    browser: object, started: Callable[..., tuple[subprocess.Popen[str], str]], band: str
) -> None:
    run, address = started("align", "bovine-muscle", "--band", band)
    page = browser.new_page(viewport={"width": 390, "height": 844})  # type: ignore[attr-defined]
    page.goto(address)
    page.wait_for_selector("#band:not(:empty)", timeout=60_000)
    inside = page.get_attribute("#band", "data-inside")
    assert (inside, page.inner_text("#band").split()[0]) == (
        ("true", "within") if band == "10:80" else ("false", "below")
    )
    assert re.search(r"highest so far [\d.]+ %, now \d+ % of it", page.inner_text("#held"))
    assert 0 < float(page.evaluate("document.getElementById('clipping').value")) < 1
    assert "% of full scale" in page.inner_text("#level")
    assert not page.locator(".run:visible").count()
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    page.click("#stop")
    page.wait_for_selector("body[data-status=aborted]", timeout=30_000)
    run.communicate(timeout=30)
    assert run.returncode == 0
    page.close()


@pytest.mark.parametrize("width", [390, 1280], ids=["phone", "desktop"])
def test_a_report_fits_the_window_asks_for_nothing_and_raises_no_complaint(
    browser: object, tmp_path: Path, width: int
) -> None:
    report = write_report(record_run(prepare("table-1"), tmp_path / "run.h5"))
    asked: list[str] = []
    page = browser.new_page(viewport={"width": width, "height": 844})  # type: ignore[attr-defined]
    page.on("request", lambda request: asked.append(request.url))
    page.on("console", lambda message: asked.append(message.text))
    page.goto(report.as_uri())
    paint_ms = first_paint_ms(page)
    print(f"{report.stat().st_size / 1e3:.0f} kB, first paint after {paint_ms:.0f} ms")
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    # what the page itself holds is no request to anybody
    assert [address for address in asked if not address.startswith("data:")] == [report.as_uri()]
    page.close()
