"""Figure of dispersion: phase velocity and attenuation over frequency, one marker for each method."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hpe_rig.moduli.wave_methods import MethodCurve
from hpe_rig.moduli.wavenumber_fit import DispersionCurve

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PAGE_SIZE_IN = (9.6, 4.2)
DASHES = ((0, (5, 2)), (0, (1, 1.5)), (0, (5, 1.5, 1, 1.5)), (0, (3, 3)))
"""Line styles of the predictions, so that methods differ in black and white too."""


def dispersion_figure(
    near: DispersionCurve,
    compared: Sequence[MethodCurve],
    *,
    simulated: bool,
    ax: Sequence[Axes] | None,
    figsize: tuple[float, float],
) -> Figure:
    """Return a figure of phase velocity and attenuation over frequency, of the near-field fit and the methods compared.

    Markers are measured, with bars of two standard uncertainties; the solid line joins the near-field fit, the broken
    lines are the results of the other methods on the exact field of the fitted medium. The panels are above each other
    if the figure is higher than wide.
    """
    from hpe_rig.result import figure_panels, mark

    is_wide = figsize[0] > figsize[1]
    figure, panels = figure_panels(1 if is_wide else 2, 2 if is_wide else 1, ax, figsize)
    curves = (
        (near.phase_velocity_m_per_s, near.phase_velocity_uncertainty_m_per_s),
        (near.attenuation_np_per_m, near.attenuation_uncertainty_np_per_m),
    )
    hz, marks = near.frequency_hz, {method.name: mark(i) for i, method in enumerate(compared, start=1)}
    for is_attenuation, axes, (value, uncertainty) in zip((False, True), panels, curves, strict=True):
        marker, colour = mark(0)
        axes.errorbar(hz, value, 2 * uncertainty, fmt=f"{marker}-", ms=4, color=colour, lw=1.2, label="near field")
        methods = [
            method for method in compared if method.is_attenuation == is_attenuation and np.isfinite(method.value).any()
        ]
        for method, dashes in zip(methods, DASHES, strict=False):
            marker, colour = marks[method.name]
            style: Any = {"fmt": marker, "ms": 4.5, "mfc": "none", "lw": 0.8, "label": method.name}
            axes.errorbar(hz, method.value, 2 * method.uncertainty, color=colour, **style)
            predicted = np.where(np.isfinite(method.value), method.predicted, np.nan)
            axes.plot(hz, predicted, ls=dashes, color=colour, lw=0.8)
        axes.set(xlabel="frequency (Hz)")
        axes.grid(alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
    if ax is None:
        _add_common_legend(figure, panels, is_wide=is_wide)
    else:
        for axes in panels:
            axes.legend(fontsize="small", frameon=False)
    panels[0].set_ylabel("phase velocity (m/s)")
    panels[1].set_ylabel("attenuation (Np/m)")
    if simulated:
        # Simulated and measured data must not be confused.
        panels[0].set_title("SIMULATED", loc="right", fontsize="small")
    return figure


def _add_common_legend(figure: Figure, panels: Sequence[Axes], *, is_wide: bool) -> None:
    """Add one legend for the curves of all panels, beside them in a wide figure and otherwise below."""
    pairs = (pair for axes in panels for pair in zip(*axes.get_legend_handles_labels(), strict=True))
    by_label = {label: handle for handle, label in pairs}
    position: Any = "outside right center" if is_wide else "outside lower center"
    columns = 1 if is_wide else 2
    figure.legend(list(by_label.values()), list(by_label), loc=position, ncols=columns, fontsize="small", frameon=False)
