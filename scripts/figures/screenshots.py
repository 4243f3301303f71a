"""Screenshots of pages and figures at three widths, light and dark, and what a browser can say of them.

Without PAGE every page and figure that the program writes is made in FOLDER, those of `MADE` by their commands, and the
live pages of `SERVED` are served; small studies, some minutes together. PAGE is a file, .html or .svg, or an address.
Each is opened in headless Chromium, all folded parts open, at 390, 800 and 1200 px. Printed for each: whether
it is wider than the window, which lines of text overlap or leave the picture that they are in, which numbers are broken
over lines, and which texts have a contrast below 3:1. FOLDER gets the PNGs.
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

MADE = {
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
"""What makes each page, one after another in one folder."""
SERVED = {
    "live": "run slow.toml --overwrite --live",
    "align": "align bovine-muscle",
    "queue": "queue slow.toml other.toml --output queue --live",
}
"""Commands that serve a page until they are stopped."""
LOOKED_AT_AFTER_MS = 6000
"""How long a live page runs before it is looked at."""
SCAN = """title = "Nine lines"
[tracking]
[acquisition]
gate_depth_m = 8e-3
gate_length_m = 1e-3
[processing]
frequencies_hz = [200.0]
"""
ALONE = """<!DOCTYPE html><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<style>:root { color-scheme: light dark } body { margin: 0 } div { overflow-x: auto }</style>
"""
WIDTHS_PX = (390, 800, 1200)
SCHEMES = ("light", "dark")
MOST = 6
"""Faults of a page that are printed."""
FLAGS = ["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking"]
FAULTS = """() => {
  const seen = [...document.querySelectorAll("svg text, h1, h2, h3, p, li, dt, dd, summary, button, figcaption")]
    .filter(e => e.textContent.trim() && !e.querySelector("p, li, summary, h2"));
  const boxes = seen
    .map(e => ({ text: e.textContent.trim().slice(0, 40), box: e.getBoundingClientRect(), svg: e.closest("svg") }))
    .filter(e => e.box.width > 0 && e.box.height > 0);
  const found = [];
  boxes.forEach((one, i) => boxes.slice(i + 1).forEach(other => {
    if (one.svg !== other.svg) return;
    const across = Math.min(one.box.right, other.box.right) - Math.max(one.box.left, other.box.left);
    const down = Math.min(one.box.bottom, other.box.bottom) - Math.max(one.box.top, other.box.top);
    if (across > 1.5 && down > 3) found.push(`overlap: "${one.text}" and "${other.text}"`);
  }));
  for (const { text, box, svg } of boxes) if (svg) {
    const frame = svg.getBoundingClientRect();
    const beyond = [frame.left - box.left, box.right - frame.right, frame.top - box.top, box.bottom - frame.bottom];
    if (Math.max(...beyond) > 2) found.push(`outside its picture: "${text}"`);
  }
  for (const e of document.querySelectorAll("td, th")) {
    const text = e.textContent.trim(), words = document.createRange();
    if (!/^[-+−–]?[\\d.,]+(e[-+]\\d+)?( ?[%\\wµ°]{1,4})?$/.test(text) || !e.getBoundingClientRect().width) continue;
    words.selectNodeContents(e);
    const lines = new Set([...words.getClientRects()].map(r => Math.round(r.top / 8)));
    if (lines.size > 1) found.push(`broken number: "${text}"`);
  }
  return found;
}"""
"""Lines of text that overlap, those that leave their picture, and numbers that go over two lines."""
CONTRASTS = """() => {
  const rgb = text => (text.match(/[\\d.]+/g) || []).map(Number);
  const linear = v => (v /= 255) <= .04045 ? v / 12.92 : ((v + .055) / 1.055) ** 2.4;
  const light = ([r, g, b]) => .2126 * linear(r) + .7152 * linear(g) + .0722 * linear(b);
  const behind = e => {
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
    const [a, b] = [light(ink), light(behind(e))].sort((x, y) => y - x), ratio = (a + .05) / (b + .05);
    if (ratio < 3) low.add(`contrast ${ratio.toFixed(1)}: "${e.textContent.trim().slice(0, 40)}"`);
  }
  return [...low];
}"""
"""Texts of a contrast below 3:1 to what is behind them."""


def main() -> None:
    """Look at every page that is named, or at all that the program has, and print what was found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("page", nargs="*")
    given = parser.parse_args()
    folder, named = given.folder.resolve(), given.page
    folder.mkdir(parents=True, exist_ok=True)
    with browser() as chromium:
        for page in named or made(folder):
            for line in looked_at(chromium, page, folder):
                print(line, flush=True)
        for key, command in {} if named else SERVED.items():
            with served(command, folder) as address:
                for line in looked_at(chromium, address, folder, key):
                    print(line, flush=True)


def made(folder: Path) -> Iterator[str]:
    """Make and yield every page of `MADE`; one whose commands fail is said to be missing."""
    _scan(folder)
    for name, commands in MADE.items():
        for command in commands:
            done = subprocess.run(_words(command), cwd=folder, capture_output=True, text=True)
            if done.returncode:
                print(f"{name}: {command} ended with {done.returncode}: {done.stderr[-300:]}")
        if (folder / name).exists():
            yield os.fspath(folder / name)


def _words(command: str) -> list[str]:
    return [sys.executable, "-m", "hpe_rig", *shlex.split(command)]


def _scan(folder: Path) -> None:
    """Write what needs input: echoes of nine lines whose motion lessens to both sides, their scene, and slow scenes."""
    import numpy as np

    from hpe_rig.scene import shipped_scenes

    pulse_s, fast_s = np.arange(80) / 4e3, np.arange(1024) / 50e6
    beside_m = (np.arange(9) - 4) * 0.5e-3
    amplitude_m = 1e-6 * np.exp(-((beside_m / 1e-3) ** 2))
    motion_m = amplitude_m[:, None] * np.sin(2 * np.pi * 200.0 * pulse_s + 0.5)
    drawn = np.random.default_rng(1)
    strength, at_s = drawn.standard_normal((9, 300)), drawn.uniform(0, fast_s[-1], (9, 300))
    rf = np.zeros((9, 80, 1024))
    for line, pulse in np.ndindex(9, 80):
        apart_s = fast_s - at_s[line, :, None] - 2 * motion_m[line, pulse] / 1540.0
        echo = np.exp(-((apart_s / 0.2e-6) ** 2)) * np.cos(2 * np.pi * 5e6 * apart_s)
        rf[line, pulse] = strength[line] @ echo
    rf += 0.02 * drawn.standard_normal(rf.shape)
    np.savez(folder / "scan.npz", rf=rf, fs=50e6, fc=5e6, prf=4e3, c=1540.0)
    (folder / "scan.toml").write_text(SCAN, encoding="utf-8")
    slow = shipped_scenes()["bovine-muscle"].replace("[acquisition]", "[acquisition]\nrepeats = 60")
    slow = slow.replace("burst_count = 20", "burst_count = 20\nforce_fraction = [0.5, 1.0]")
    for name in ("slow.toml", "other.toml"):
        (folder / name).write_text(slow, encoding="utf-8")


@contextmanager
def served(command: str, folder: Path) -> Iterator[str]:
    """Run a command and yield the address of the page that it serves; end it after."""
    run = subprocess.Popen(
        _words(command),
        cwd=folder,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        for said in run.stdout or ():
            if found := re.search(r"http://127\.0\.0\.1:\d+/\S+/", said):
                yield found.group()
                break
    finally:
        run.terminate()
        run.communicate(timeout=60)


@contextmanager
def browser() -> Iterator[Any]:
    """Yield a headless Chromium."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        yield chromium
        chromium.close()


def looked_at(chromium: Any, name: str, folder: Path, key: str = "") -> Iterator[str]:
    """Yield a line a width and scheme of one page: what is wrong with it; write its screenshot."""
    live = name.startswith("http")
    address, key = (name, key or "live") if live else (_as_page(Path(name), folder).as_uri(), Path(name).stem)
    for width_px in WIDTHS_PX:
        for scheme in SCHEMES:
            page = chromium.new_page(viewport={"width": width_px, "height": 900}, color_scheme=scheme)
            page.goto(address)
            if live:
                page.wait_for_timeout(LOOKED_AT_AFTER_MS)
            faults = faults_of(page, width_px)
            page.screenshot(path=folder / f"{key}-{width_px}-{scheme}.png", full_page=True)
            page.close()
            yield f"{key}, {width_px} px, {scheme}: {'; '.join(faults[:MOST]) or 'nothing wrong'}"


def _as_page(file: Path, folder: Path) -> Path:
    """Return ``file`` where it is a page; of a figure a page that holds it alone, in its own size."""
    if file.suffix != ".svg":
        return file.resolve()
    drawn = file.read_text(encoding="utf-8")
    page = folder.resolve() / f"{file.name}.html"
    page.write_text(f"{ALONE}<div>{drawn[drawn.index('<svg') :]}</div>", encoding="utf-8")
    return page


def faults_of(page: Any, width_px: int) -> list[str]:
    """Return what a browser finds wrong with ``page``, every folded part of it open."""
    for part in page.locator("details").all():
        part.evaluate("part => part.open = true")
    wide = page.evaluate("document.documentElement.scrollWidth")
    faults = [f"{wide} px wide"] if wide > width_px else []
    return [*faults, *page.evaluate(FAULTS), *page.evaluate(CONTRASTS)]


if __name__ == "__main__":
    main()
