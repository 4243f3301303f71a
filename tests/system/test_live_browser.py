"""Live page and report in headless Chromium: Debian's package, driven by playwright (extra browser); -m external."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from hpe_rig.acquire.run import prepare, record_run
from hpe_rig.report.page import write_report
from hpe_rig.scene.scene import shipped_scenes
from hpe_rig.store import read_run

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
