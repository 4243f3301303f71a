"""Pictures over depth: amplitude and phase in every gate, and the motion within the burst period."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from hpe_rig.result import GateResult, Headline, Picture, legend_above, mark, panel, picture

MOST_CURVES = 4
"""Frequencies drawn, those that move most: of more nothing could be told apart."""


def profile_pictures(gates: Sequence[GateResult]) -> tuple[Picture, ...]:
    """Return amplitude, phase and motion over the depth of ``gates`` of one shot; nothing for fewer than two."""
    if len(gates) < 2:
        return ()
    gates = sorted(gates, key=lambda gate: gate.depth_m)
    drawn = (
        _curves(gates, "amplitude", "nm", lambda head: (head.amplitude_m * 1e9, head.amplitude_uncertainty_m * 1e9)),
        _curves(gates, "phase", "deg", lambda head: (head.phase_rad, head.phase_uncertainty_rad)),
    )
    return drawn if not gates[0].motion_time_s else (*drawn, _motion(gates))


def _curves(
    gates: Sequence[GateResult], what: str, unit: str, value_of: Callable[[Headline], tuple[float, float]]
) -> Picture:
    """Return a curve a frequency over depth, with bars of 2 u; of phases in radians unwrapped, in degrees."""
    depth_mm, said = np.array([gate.depth_m for gate in gates]) * 1e3, list[str]()
    figure, axes = panel()
    size = np.max([[each.amplitude_m for each in gate.shot.estimates] for gate in gates], axis=0)
    for place, index in enumerate(sorted(np.argsort(size)[::-1][:MOST_CURVES].tolist())):
        hz, (marker, colour) = gates[0].shot.estimates[index].frequency_hz, mark(place)
        value, u = np.array([value_of(gate.shot.estimates[index].headline) for gate in gates]).T
        if what == "phase":
            value, u = np.degrees(np.unwrap(value)), np.degrees(u)
        axes.errorbar(depth_mm, value, 2 * u, marker=marker, ms=4, color=colour, capsize=2, label=f"{hz:g} Hz")
        said.append(f"{value.min():.4g} to {value.max():.4g} {unit} at {hz:g} Hz")
    axes.set(xlabel="depth (mm)", ylabel=f"{what} ({unit})")
    if what == "amplitude":
        axes.set_ylim(0, None)
    legend_above(axes, MOST_CURVES)
    alt = f"{what.title()} in {len(gates)} gates from {depth_mm[0]:.4g} to {depth_mm[-1]:.4g} mm: {'; '.join(said)}."
    return picture(figure, f"depth-{what}", f"{what.title()} over depth, bars of 2 u", alt)


def _motion(gates: Sequence[GateResult]) -> Picture:
    figure, axes = panel()
    depth_mm, time_ms = np.array([gate.depth_m for gate in gates]) * 1e3, np.array(gates[0].motion_time_s) * 1e3
    nothing = (np.nan,) * time_ms.size
    # in um: numbers of five digits would push the bar's name off the panel
    moved_um = np.array([gate.motion_m or nothing for gate in gates]) * 1e6
    limit_um = float(np.nanmax(np.abs(moved_um), initial=0.0)) or 1.0
    axes.set_facecolor("#BBBBBB")
    image = axes.pcolormesh(
        time_ms, depth_mm, moved_um, cmap="RdBu_r", vmin=-limit_um, vmax=limit_um, rasterized=True, shading="nearest"
    )
    bar = figure.colorbar(image)
    bar.set_label("displacement (um)", size=9)
    bar.ax.tick_params(labelsize=9)
    axes.grid(visible=False)
    axes.invert_yaxis()
    axes.set(xlabel="time after a toneburst's arrival (ms)", ylabel="depth (mm)")
    alt = (
        f"Mean displacement within the burst period of {time_ms[-1] + time_ms[0]:.4g} ms in {len(gates)} gates from "
        f"{depth_mm[0]:.4g} to {depth_mm[-1]:.4g} mm, between {np.nanmin(moved_um):.4g} and "
        f"{np.nanmax(moved_um):.4g} um about its mean."
    )
    return picture(figure, "depth-motion", "Motion over depth and burst period", alt)
