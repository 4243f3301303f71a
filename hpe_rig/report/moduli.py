"""Moduli of the medium in the report: what ``hpe-rig moduli`` says of a run at several places, with the figure."""

from __future__ import annotations

import io
from dataclasses import dataclass

from matplotlib import rc_context

from hpe_rig.result import STYLE, Picture, inline
from hpe_rig.runs import Run, fit_moduli
from hpe_rig.scene import SettingsError
from hpe_rig.store import StoreError


@dataclass(frozen=True, slots=True)
class ModuliPart:
    """What the report says: ``text``, and the ``picture`` of measured and fitted vibrations where there is a fit."""

    text: str
    picture: Picture | None


def moduli_part(run: Run, estimator: str | None = None) -> ModuliPart | None:
    """Return the moduli of ``run``, or why there are none; None for a run at a single place, or without tonebursts."""
    if len(run.plan.places_m) < 2 or run.scene.excitation is None or run.scene.beams is None:
        return None
    try:
        result = fit_moduli(run, estimator=estimator)
    except (StoreError, SettingsError) as error:
        return ModuliPart(str(error), None)
    text = io.StringIO()
    with rc_context(STYLE):
        result.figure().savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    title = "Measured and fitted vibrations"
    alt = f"Amplitude and phase over frequency at {len(result.vibrations)} places and depths. {result.headline}."
    return ModuliPart(str(result), Picture("moduli", title, alt, inline(text.getvalue(), "moduli", title, alt)))
