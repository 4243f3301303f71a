"""Screenshots of pages at three widths, light and dark, and what a browser can say of them.

    python scripts/screenshots.py FOLDER PAGE.html ...

Every page is opened in headless Chromium, all folded parts open, at 390, 800 and 1200 px. Printed for each: whether
it is wider than the window, which lines of text overlap or leave the picture that they are in, and which texts have a
contrast below 3:1. FOLDER gets the PNGs. An address (http://...) is taken like a file: the live page.
"""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

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
  return found;
}"""
"""Lines of text that overlap, and those that leave their picture."""
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
    """Look at every page that is named, and print what was found."""
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for line in looked_at(sys.argv[2:], folder):
        print(line, flush=True)


def looked_at(pages: list[str], folder: Path) -> Iterator[str]:
    """Yield a line a page, width and scheme: its height and what is wrong with it; write its screenshot."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        for name in pages:
            served = name.startswith("http")
            address, key = (name, "live") if served else (Path(name).resolve().as_uri(), Path(name).stem)
            for width_px in WIDTHS_PX:
                for scheme in SCHEMES:
                    page = chromium.new_page(viewport={"width": width_px, "height": 900}, color_scheme=scheme)
                    page.goto(address)
                    if served:
                        page.wait_for_timeout(1500)
                    faults = faults_of(page, width_px)
                    page.screenshot(path=folder / f"{key}-{width_px}-{scheme}.png", full_page=True)
                    page.close()
                    yield f"{key}, {width_px} px, {scheme}: {'; '.join(faults[:MOST]) or 'nothing wrong'}"
        chromium.close()


def faults_of(page: Any, width_px: int) -> list[str]:
    """Return what a browser finds wrong with ``page``, every folded part of it open."""
    for part in page.locator("details").all():
        part.evaluate("part => part.open = true")
    wide = page.evaluate("document.documentElement.scrollWidth")
    faults = [f"{wide} px wide"] if wide > width_px else []
    return [*faults, *page.evaluate(FAULTS), *page.evaluate(CONTRASTS)]


if __name__ == "__main__":
    main()
