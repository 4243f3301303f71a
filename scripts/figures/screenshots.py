"""Take screenshots of pages and figures in headless Chromium, and report faults of their layout.

Without PAGE, every page and figure that the program writes is made in FOLDER, and the live pages are served. This takes
some minutes, with small studies. PAGE is a file, .html or .svg, or an address.

Each page is opened at widths of 390, 800 and 1400 px, in light and dark mode, with all folded parts open. Reported are:
pages wider than the window, overlapping text, text outside its picture, numbers broken over lines, and contrast below
3:1. FOLDER receives the PNG files.
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

PAGES = {
    "bovine-muscle.html": ("run bovine-muscle --report --overwrite",),
    "gelatin-moduli.html": ("run gelatin-moduli --yes --report --overwrite",),
    "moduli.svg": ("moduli gelatin-moduli.h5 --figure moduli.svg",),
    "compare.svg": ("run gelatin-8 --overwrite", "compare bovine-muscle.h5 gelatin-8.h5 --figure compare.svg"),
    "map.svg": ("map scan.npz --scene scan.toml --set axes=line,pulse,sample --figure map.svg",),
    "bovine-muscle-design.html": ("design bovine-muscle --over pulse_rate_hz,gate_length_m --draws 5 --report",),
    "studies/fig-7.html": ("study fig-7 --scatterers 4 --noise 2 --workers 1 --report",),
    "studies/fig-4.html": ("study fig-4 --points 5 --scatterers 2 --noise 1 --workers 1 --report",),
    "studies/reproduction.html": ("study reproduction --points 5 --scatterers 2 --noise 1 --workers 1 --report",),
    "accuracy.html": ("accuracy --largest 1000 --most-echoes 100 --longest-s 0.2 --draws 3",),
}
"""Commands that make each page or figure, in this order in one folder."""
LIVE_PAGES = {
    "live": "run slow.toml --overwrite --live",
    "align": "align bovine-muscle",
    "queue": "queue slow.toml other.toml --output queue --live",
}
"""Commands that serve a page until they are stopped, by the name of the screenshot."""
LIVE_PAGE_DELAY_MS = 6000
"""Time that a live page runs before its screenshot."""
SCAN = """title = "Nine lines"
[tracking]
[acquisition]
gate_depth_m = 8e-3
gate_length_m = 1e-3
[processing]
frequencies_hz = [200.0]
"""
FIGURE_PAGE = """<!DOCTYPE html><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<style>:root { color-scheme: light dark } body { margin: 0 } div { overflow-x: auto }</style>
"""
WIDTHS_PX = (390, 800, 1400)
SCHEMES = ("light", "dark")
MAX_FAULTS = 6
"""Faults printed per page."""
FLAGS = ["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking"]
FAULTS = """() => {
  const texts = [...document.querySelectorAll("svg text, h1, h2, h3, p, li, dt, dd, summary, button, figcaption")]
    .filter(e => e.textContent.trim() && !e.querySelector("p, li, summary, h2"));
  const boxes = texts
    .map(e => ({ text: e.textContent.trim().slice(0, 40), box: e.getBoundingClientRect(), svg: e.closest("svg") }))
    .filter(e => e.box.width > 0 && e.box.height > 0);
  const faults = [];
  boxes.forEach((a, i) => boxes.slice(i + 1).forEach(b => {
    if (a.svg !== b.svg) return;
    const width = Math.min(a.box.right, b.box.right) - Math.max(a.box.left, b.box.left);
    const height = Math.min(a.box.bottom, b.box.bottom) - Math.max(a.box.top, b.box.top);
    if (width > 1.5 && height > 3) faults.push(`overlap: "${a.text}" and "${b.text}"`);
  }));
  for (const { text, box, svg } of boxes) if (svg) {
    const frame = svg.getBoundingClientRect();
    const excess = [frame.left - box.left, box.right - frame.right, frame.top - box.top, box.bottom - frame.bottom];
    if (Math.max(...excess) > 2) faults.push(`outside its picture: "${text}"`);
  }
  for (const e of document.querySelectorAll("td, th")) {
    const text = e.textContent.trim(), words = document.createRange();
    if (!/^[-+−–]?[\\d.,]+(e[-+]\\d+)?( ?[%\\wµ°]{1,4})?$/.test(text) || !e.getBoundingClientRect().width) continue;
    words.selectNodeContents(e);
    const lines = new Set([...words.getClientRects()].map(r => Math.round(r.top / 8)));
    if (lines.size > 1) faults.push(`broken number: "${text}"`);
  }
  return faults;
}"""
"""JavaScript: overlapping texts, texts outside their picture, and numbers broken over two lines."""
CONTRASTS = """() => {
  const rgb = text => (text.match(/[\\d.]+/g) || []).map(Number);
  const linear = v => (v /= 255) <= .04045 ? v / 12.92 : ((v + .055) / 1.055) ** 2.4;
  const luminance = ([r, g, b]) => .2126 * linear(r) + .7152 * linear(g) + .0722 * linear(b);
  const background = e => {
    for (; e; e = e.parentElement) {
      const colour = rgb(getComputedStyle(e).backgroundColor);
      if (colour.length && colour[3] !== 0) return colour;
    }
    return [255, 255, 255];
  };
  const low = new Set();
  for (const e of document.querySelectorAll("svg text, p, li, td, th, dt, dd, summary, button, h1, h2, h3, a")) {
    if (!e.textContent.trim() || !e.getBoundingClientRect().width) continue;
    const style = getComputedStyle(e), ink = rgb(e.closest("svg") ? style.fill : style.color);
    const [a, b] = [luminance(ink), luminance(background(e))].sort((x, y) => y - x), ratio = (a + .05) / (b + .05);
    if (ratio < 3) low.add(`contrast ${ratio.toFixed(1)}: "${e.textContent.trim().slice(0, 40)}"`);
  }
  return [...low];
}"""
"""JavaScript: texts with a contrast ratio below 3:1, as WCAG 2 defines it."""


def main() -> None:
    """Check the named pages, or all pages of the program, and print their faults."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("page", nargs="*")
    options = parser.parse_args()
    folder = options.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    with browser() as chromium:
        for page in options.page or make_pages(folder):
            for line in check_page(chromium, page, folder):
                print(line, flush=True)
        for name, command in {} if options.page else LIVE_PAGES.items():
            with serving(command, folder) as address:
                for line in check_page(chromium, address, folder, name):
                    print(line, flush=True)


def make_pages(folder: Path) -> Iterator[str]:
    """Make and yield every page of ``PAGES``; print the commands that fail."""
    write_inputs(folder)
    for name, commands in PAGES.items():
        for command in commands:
            done = subprocess.run(_arguments(command), cwd=folder, capture_output=True, text=True)
            if done.returncode:
                print(f"{name}: {command} ended with {done.returncode}: {done.stderr[-300:]}")
        if (folder / name).exists():
            yield os.fspath(folder / name)


def _arguments(command: str) -> list[str]:
    return [sys.executable, "-m", "hpe_rig", *shlex.split(command)]


def write_inputs(folder: Path) -> None:
    """Write the input files of the commands: echoes of nine lines with their scene, and two slow scenes.

    The motion of the lines is largest at the middle one.
    """
    import numpy as np

    from hpe_rig.scene import shipped_scenes

    pulse_s, fast_s = np.arange(80) / 4e3, np.arange(1024) / 50e6
    lateral_m = (np.arange(9) - 4) * 0.5e-3
    amplitude_m = 1e-6 * np.exp(-((lateral_m / 1e-3) ** 2))
    motion_m = amplitude_m[:, None] * np.sin(2 * np.pi * 200.0 * pulse_s + 0.5)
    rng = np.random.default_rng(1)
    strength, delay_s = rng.standard_normal((9, 300)), rng.uniform(0, fast_s[-1], (9, 300))
    rf = np.zeros((9, 80, 1024))
    for line, pulse in np.ndindex(9, 80):
        # Each scatterer returns a Gaussian pulse, delayed by twice the displacement over the sound speed.
        age_s = fast_s - delay_s[line, :, None] - 2 * motion_m[line, pulse] / 1540.0
        echo = np.exp(-((age_s / 0.2e-6) ** 2)) * np.cos(2 * np.pi * 5e6 * age_s)
        rf[line, pulse] = strength[line] @ echo
    rf += 0.02 * rng.standard_normal(rf.shape)
    np.savez(folder / "scan.npz", rf=rf, fs=50e6, fc=5e6, prf=4e3, c=1540.0)
    (folder / "scan.toml").write_text(SCAN, encoding="utf-8")
    slow = shipped_scenes()["bovine-muscle"].replace("[acquisition]", "[acquisition]\nrepeats = 60")
    slow = slow.replace("burst_count = 20", "burst_count = 20\nforce_fraction = [0.5, 1.0]")
    for name in ("slow.toml", "other.toml"):
        (folder / name).write_text(slow, encoding="utf-8")


@contextmanager
def serving(command: str, folder: Path) -> Iterator[str]:
    """Run a command, yield the address of the page that it serves, and stop it at the end."""
    process = subprocess.Popen(
        _arguments(command),
        cwd=folder,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        for line in process.stdout or ():
            if address := re.search(r"http://127\.0\.0\.1:\d+/\S+/", line):
                yield address.group()
                break
    finally:
        process.terminate()
        process.communicate(timeout=60)


@contextmanager
def browser() -> Iterator[Any]:
    """Yield a headless Chromium."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        yield chromium
        chromium.close()


def check_page(chromium: Any, page_or_address: str, folder: Path, name: str = "live") -> Iterator[str]:
    """Write screenshots of one page, and yield its faults, a line for each width and colour scheme."""
    live = page_or_address.startswith("http")
    address = page_or_address
    if not live:
        file = Path(page_or_address)
        address, name = _as_page(file, folder).as_uri(), file.stem
    for width_px in WIDTHS_PX:
        for scheme in SCHEMES:
            page = chromium.new_page(viewport={"width": width_px, "height": 900}, color_scheme=scheme)
            page.goto(address)
            # A live page shows its first shots after a few seconds.
            if live:
                page.wait_for_timeout(LIVE_PAGE_DELAY_MS)
            faults = faults_of(page, width_px)
            page.screenshot(path=folder / f"{name}-{width_px}-{scheme}.png", full_page=True)
            page.close()
            yield f"{name}, {width_px} px, {scheme}: {'; '.join(faults[:MAX_FAULTS]) or 'nothing wrong'}"


def _as_page(file: Path, folder: Path) -> Path:
    """Return ``file``, or for a figure a page that contains it in its own size."""
    if file.suffix != ".svg":
        return file.resolve()
    figure = file.read_text(encoding="utf-8")
    page = folder.resolve() / f"{file.name}.html"
    page.write_text(f"{FIGURE_PAGE}<div>{figure[figure.index('<svg') :]}</div>", encoding="utf-8")
    return page


def faults_of(page: Any, width_px: int) -> list[str]:
    """Open all folded parts of ``page`` and return the faults of its layout."""
    for details in page.locator("details").all():
        details.evaluate("details => details.open = true")
    page_px = page.evaluate("document.documentElement.scrollWidth")
    faults = [f"{page_px} px wide"] if page_px > width_px else []
    return [*faults, *page.evaluate(FAULTS), *page.evaluate(CONTRASTS)]


if __name__ == "__main__":
    main()
