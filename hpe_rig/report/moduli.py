"""Moduli of the medium on a run's page: the text of ``hpe-rig moduli`` and its figure."""

from __future__ import annotations

from matplotlib import rc_context

from hpe_rig.result import STYLE, Picture, picture
from hpe_rig.runs import Run, fit_moduli
from hpe_rig.scene import SettingsError
from hpe_rig.store import StoreError


def moduli_summary(run: Run, estimator: str | None = None) -> tuple[str, Picture | None] | None:
    """Return the moduli of ``run`` in words and as a picture; the reason and None if there are none.

    None for a run at a single lateral offset, without tonebursts or without beams, which cannot resolve moduli.
    """
    if len(run.plan.lateral_offsets_m) < 2 or run.scene.excitation is None or run.scene.beams is None:
        return None
    try:
        result = fit_moduli(run, estimator=estimator)
    except (StoreError, SettingsError) as error:
        return str(error), None
    with rc_context(STYLE):
        figure = result.figure()
    alt = f"Amplitude and phase over frequency at {len(result.vibrations)} places and depths. {result.headline}."
    return str(result), picture(figure, "moduli", "Measured and fitted vibrations", alt)
