"""Figure of measured and fitted vibrations: amplitude and phase over frequency, one marker for each gate."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hpe_rig.arrays import ComplexArray
from hpe_rig.moduli.vibration_model import Vibration

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def moduli_figure(vibrations: Sequence[Vibration], modelled_m: Sequence[ComplexArray], title: str) -> Figure:
    """Return a figure of amplitude and phase over frequency, one colour for each lateral offset.

    Measured points have bars of two standard uncertainties; lines are ``modelled_m``, the phasors of a fitted medium.
    """
    from matplotlib.figure import Figure

    from hpe_rig.result import mark

    figure = Figure(figsize=(9.6, 4.2), layout="constrained")
    amplitude, phase = figure.subplots(1, 2)
    for index, (vibration, modelled) in enumerate(zip(vibrations, modelled_m, strict=True)):
        marker, colour = mark(index)
        # Mean variance of the two quadratures of each harmonic.
        variance = np.diag(vibration.covariance_m2).reshape(-1, 2).mean(axis=1)
        sigma_m, size_m, hz = np.sqrt(variance), np.abs(vibration.phasor_m), vibration.frequency_hz
        style = {"fmt": marker, "ms": 4, "color": colour, "lw": 1}
        amplitude.errorbar(hz, size_m * 1e9, 2e9 * sigma_m, label=vibration.label, **style)
        amplitude.plot(hz, np.abs(modelled) * 1e9, color=colour, lw=1)
        # The model is unwrapped over frequency; measured phases are within half a turn of it.
        model_rad = np.unwrap(np.angle(modelled))
        deviation_rad = np.angle(vibration.phasor_m / modelled)
        phase.errorbar(hz, np.degrees(model_rad + deviation_rad), 2 * np.degrees(sigma_m / size_m), **style)
        phase.plot(hz, np.degrees(model_rad), color=colour, lw=1)
    amplitude.set(xlabel="frequency (Hz)", ylabel="amplitude (nm)", yscale="log")
    phase.set(xlabel="frequency (Hz)", ylabel="phase (deg)")
    handles_and_labels = amplitude.get_legend_handles_labels()
    style = {"fontsize": "small", "title_fontsize": "small", "frameon": False}
    figure.legend(*handles_and_labels, title="lateral offset", loc="outside right center", **style)
    for axes in (amplitude, phase):
        axes.grid(alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
    figure.suptitle(title, fontsize="medium")
    return figure
