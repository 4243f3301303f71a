"""Lines of a recording: one, several, each a place, or their mean."""

from __future__ import annotations

import re

from hpe_rig.scene import Mistake


def chosen_lines(text: str | None, count: int) -> tuple[slice, bool] | Mistake:
    """Return which of ``count`` lines are taken, and whether their mean is; a mistake for what names none.

    Lines count from 1 in ``text``: "12", "10-20", "all", "mean", "mean:10-20"; None takes the only one.
    """
    if text is None:
        if count == 1:
            return slice(0, 1), False
        what = f"the recording has {count} lines and none is chosen"
        return Mistake("lines", what, f'"{(count + 1) // 2}" for one, "mean" for their mean, "all" for each as a place')
    words = text.strip().lower().replace(" ", "")
    mean = words.startswith("mean")
    rest = words.removeprefix("mean").removeprefix(":") if mean else words
    if rest in ("", "all"):
        if not (mean or rest):
            return Mistake("lines", f"{text!r} names no line", '"12", "10-20", "all" or "mean"')
        return slice(0, count), mean
    match = re.fullmatch(r"(\d{1,9})(?:-(\d{1,9}))?", rest)
    if match is None:
        return Mistake("lines", f"{text!r} names no line", '"12", "10-20", "all", "mean" or "mean:10-20"')
    first = int(match[1])
    last = int(match[2] or first)
    if not 1 <= first <= last <= count:
        return Mistake("lines", f"{text!r} is not within the {count} lines of the recording", f'"1-{count}"')
    return slice(first - 1, last), mean
