"""Moduli of the medium on a run's page: the text of ``hpe-rig moduli`` and its figure."""

from __future__ import annotations

from dataclasses import dataclass

from matplotlib import rc_context

from hpe_rig.moduli import moduli_figure
from hpe_rig.result import STYLE, Picture, picture
from hpe_rig.runs import Run, fit_moduli
from hpe_rig.scene import SettingsError
from hpe_rig.store import StoreError


@dataclass(frozen=True, slots=True)
class ModuliSummary:
    """The moduli in words, or the reason why there are none, and the measured and fitted vibrations."""

    text: str
    picture: Picture | None


def moduli_summary(run: Run, estimator: str | None = None) -> ModuliSummary | None:
    """Return the moduli of ``run``; None for a run at a single lateral offset, without tonebursts or without beams."""
    if len(run.plan.lateral_offsets_m) < 2 or run.scene.excitation is None or run.scene.beams is None:
        return None
    try:
        result = fit_moduli(run, estimator=estimator)
    except (StoreError, SettingsError) as error:
        return ModuliSummary(str(error), None)
    with rc_context(STYLE):
        figure = moduli_figure(result)
    alt = f"Amplitude and phase over frequency at {len(result.vibrations)} places and depths. {result.headline}."
    return ModuliSummary(str(result), picture(figure, "moduli", "Measured and fitted vibrations", alt))
