"""Figure of measured and fitted vibrations: amplitude and phase over frequency, a mark a place."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hpe_rig.moduli.outcome import ModuliResult


def moduli_figure(result: ModuliResult) -> Figure:
    """Return the figure; lines are the likeliest medium, points with bars of 2 u what was measured."""
    from matplotlib.figure import Figure

    from hpe_rig.result import mark

    figure = Figure(figsize=(9.6, 4.2), layout="constrained")
    amplitude, phase = figure.subplots(1, 2)
    for place, (one, modelled) in enumerate(zip(result.vibrations, result.best.modelled_m, strict=True)):
        marker, colour = mark(place)
        variance = np.diag(one.covariance_m2).reshape(-1, 2).mean(axis=1)
        sigma, size = np.sqrt(variance), np.abs(one.phasor_m)
        style = {"fmt": marker, "ms": 4, "color": colour, "lw": 1}
        amplitude.errorbar(one.frequency_hz, size * 1e9, 2e9 * sigma, label=one.label, **style)
        amplitude.plot(one.frequency_hz, np.abs(modelled) * 1e9, color=colour, lw=1)
        # the model is unwrapped over frequency, and what was measured lies within half a turn of it
        turned = np.unwrap(np.angle(modelled))
        off = np.angle(one.phasor_m / modelled)
        phase.errorbar(one.frequency_hz, np.degrees(turned + off), 2 * np.degrees(sigma / size), **style)
        phase.plot(one.frequency_hz, np.degrees(turned), color=colour, lw=1)
    amplitude.set(xlabel="frequency (Hz)", ylabel="amplitude (nm)", yscale="log")
    phase.set(xlabel="frequency (Hz)", ylabel="phase (deg)")
    places = amplitude.get_legend_handles_labels()
    figure.legend(
        *places,
        title="beside the push",
        loc="outside right center",
        fontsize="small",
        title_fontsize="small",
        frameon=False,
    )
    for axes in (amplitude, phase):
        axes.grid(alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
    figure.suptitle(result.headline, fontsize="medium")
    return figure
