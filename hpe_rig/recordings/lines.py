"""Selection of the lines of a recording: one, several, or their mean."""

from __future__ import annotations

import re

from hpe_rig.scene import Mistake


def select_lines(text: str | None, count: int) -> tuple[slice, bool] | Mistake:
    """Return the range of the selected of ``count`` lines, and whether to average them; a mistake for invalid text.

    Lines count from 1 in ``text``: "12", "10-20", "all", "mean", "mean:10-20". None selects the only line.
    """
    if text is None:
        if count == 1:
            return slice(0, 1), False
        what = f"the recording has {count} lines and none is selected"
        return Mistake("lines", what, f'"{(count + 1) // 2}" for one, "mean" for their mean, "all" for each')
    words = text.strip().lower().replace(" ", "")
    mean = words.startswith("mean")
    numbers = words.removeprefix("mean").removeprefix(":") if mean else words
    if numbers == "all" or (mean and not numbers):
        return slice(0, count), mean
    match = re.fullmatch(r"(\d{1,9})(?:-(\d{1,9}))?", numbers)
    if match is None:
        return Mistake("lines", f"{text!r} names no line", '"12", "10-20", "all", "mean" or "mean:10-20"')
    first = int(match[1])
    last = int(match[2] or first)
    if not 1 <= first <= last <= count:
        return Mistake("lines", f"{text!r} is not within the {count} lines of the recording", f'"1-{count}"')
    return slice(first - 1, last), mean
