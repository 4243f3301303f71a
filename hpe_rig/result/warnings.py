"""The warnings of many shots, each kind of them once."""

from __future__ import annotations

import re
from collections.abc import Sequence

from hpe_rig.result.estimates import ShotResult

MOST_NUMBERS = 12


def shot_warnings(shots: Sequence[ShotResult]) -> list[str]:
    """Return the warnings of ``shots``, alike but for their numbers taken together, with the shots that have them."""
    kinds: dict[str, dict[int, str]] = {}
    for shot in shots:
        for text in shot.warnings:
            kinds.setdefault(re.sub(r"\d[\d., ]*", "#", text), {}).setdefault(shot.shot + 1, text)
    if len(shots) == 1:
        return list(shots[0].warnings)
    return [_words(by_shot, len(shots)) for by_shot in kinds.values()]


def _words(by_shot: dict[int, str], shots: int) -> str:
    numbers = ", ".join(map(str, list(by_shot)[:MOST_NUMBERS]))
    if len(by_shot) > MOST_NUMBERS:
        numbers += f" ... ({len(by_shot)} of {shots} shots)"
    first, text = next(iter(by_shot.items()))
    example = "" if len(set(by_shot.values())) == 1 else f"such as in shot {first}, "
    return f"shot {numbers}: {example}{text}"
