"""The live page in headless Chromium. Needs playwright and Debian's chromium, so it is no part of the default run."""

from __future__ import annotations

import re
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from hpe_rig.scene import shipped_scenes
from hpe_rig.store import read_run

playwright = pytest.importorskip("playwright.sync_api")
CHROMIUM = Path("/usr/bin/chromium")
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

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not CHROMIUM.exists(), reason="Debian's chromium is not installed"),
    pytest.mark.filterwarnings("default"),
]


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
    with playwright.sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=str(CHROMIUM), args=FLAGS)
        yield chromium
        chromium.close()


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
    paint_ms = pages[0].evaluate("performance.getEntriesByType('paint').map(entry => entry.startTime)")
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
    print(f"first paint after {min(paint_ms):.0f} ms")
    # the goal on this machine; a loaded machine paints later
    assert min(paint_ms) < 1000
    for page in pages:
        page.close()
