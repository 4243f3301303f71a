"""``hpe-rig accuracy motion`` and ``harmonic``: the studies by name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from hpe_rig.validation.accuracy import harmonic as accuracy_harmonic, motion as accuracy_motion
from hpe_rig.validation.accuracy.table import draw_harmonic, draw_motion, write_rows


def write_estimator_accuracy(
    of: str, output: Path | None, figure: Path | None, draws: int, tell: Callable[[str], None]
) -> None:
    """Run the study ``of`` "motion" or "harmonic" and write table and figure."""
    if of == "motion":
        write_rows(accuracy_motion.rows(draws=draws), output, figure, draw_motion, tell)
    else:
        write_rows(accuracy_harmonic.rows(), output, figure, draw_harmonic, tell)
