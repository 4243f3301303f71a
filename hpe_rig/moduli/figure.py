"""Figure of measured and fitted vibrations: amplitude and phase over frequency, one marker for each gate."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hpe_rig.arrays import ComplexArray
from hpe_rig.moduli.vibration_model import Vibration

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PAGE_SIZE_IN = (9.6, 4.2)


def moduli_figure(
    vibrations: Sequence[Vibration],
    modelled_m: Sequence[ComplexArray],
    title: str,
    *,
    simulated: bool,
    ax: Axes | Sequence[Axes] | None = None,
    figsize: tuple[float, float] = PAGE_SIZE_IN,
) -> Figure:
    """Return a figure of amplitude and phase over frequency, one colour for each lateral offset.

    Measured points have bars of two standard uncertainties; lines are ``modelled_m``, the phasors of a fitted medium.
    ``ax``: axes for amplitude and phase; ``figsize``, inches, of a new figure, with the panels above each other if it
    is higher than wide.
    """
    from hpe_rig.result import figure_panels, mark

    is_wide = figsize[0] > figsize[1]
    figure, (amplitude, phase) = figure_panels(1 if is_wide else 2, 2 if is_wide else 1, ax, figsize)
    for index, (vibration, modelled) in enumerate(zip(vibrations, modelled_m, strict=True)):
        marker, colour = mark(index)
        # Mean variance of the two quadratures of each harmonic.
        variance = np.diag(vibration.covariance_m2).reshape(-1, 2).mean(axis=1)
        sigma_m, size_m, hz = np.sqrt(variance), np.abs(vibration.phasor_m), vibration.frequency_hz
        style: Any = {"fmt": marker, "ms": 4, "color": colour, "lw": 1}
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
    small: Any = {"fontsize": "small", "title_fontsize": "small", "frameon": False}
    if ax is None:
        position: Any = "outside right center" if is_wide else "outside lower center"
        columns = 1 if is_wide else 3
        figure.legend(*handles_and_labels, title="lateral offset", loc=position, ncols=columns, **small)
    else:
        amplitude.legend(title="lateral offset", **small)
    for axes in (amplitude, phase):
        axes.grid(alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
    if simulated:
        # Simulated and measured data must not be confused.
        amplitude.set_title("SIMULATED", loc="right", fontsize="small")
    if ax is None and is_wide:
        figure.suptitle(title, fontsize="medium")
    return figure
