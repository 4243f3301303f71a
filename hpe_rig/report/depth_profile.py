"""Pictures over depth: amplitude and phase in every gate, and the mean motion within the burst period."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from hpe_rig.result import Estimate, GateResult, Picture, legend, mark, panel, picture

MAX_CURVES = 4
"""Frequencies in a picture, those with the largest amplitudes; more curves would be illegible."""


def profile_pictures(gates: Sequence[GateResult]) -> tuple[Picture, ...]:
    """Return amplitude, phase and motion over the depth of ``gates`` of one shot; empty for fewer than two gates."""
    if len(gates) < 2:
        return ()
    gates = sorted(gates, key=lambda gate: gate.depth_m)
    pictures = (
        _curves(gates, "amplitude", "nm", lambda head: (head.amplitude_m * 1e9, head.amplitude_uncertainty_m * 1e9)),
        _curves(gates, "phase", "deg", lambda head: (head.phase_rad, head.phase_uncertainty_rad)),
    )
    return (*pictures, _motion(gates)) if gates[0].motion_time_s else pictures


def _curves(
    gates: Sequence[GateResult], quantity: str, unit: str, value_of: Callable[[Estimate], tuple[float, float]]
) -> Picture:
    """Return a curve over depth for each frequency, with bars of 2 u; phases are unwrapped, in degrees."""
    depth_mm = np.array([gate.depth_m for gate in gates]) * 1e3
    descriptions = []
    figure, axes = panel()
    largest_m = np.max([[estimate.amplitude_m for estimate in gate.shot.estimates] for gate in gates], axis=0)
    # Curves in the order of frequency, so that colours are stable.
    for curve, index in enumerate(sorted(np.argsort(largest_m)[::-1][:MAX_CURVES].tolist())):
        hz, (marker, colour) = gates[0].shot.estimates[index].frequency_hz, mark(curve)
        value, u = np.array([value_of(gate.shot.estimates[index]) for gate in gates]).T
        if quantity == "phase":
            value, u = np.degrees(np.unwrap(value)), np.degrees(u)
        axes.errorbar(depth_mm, value, 2 * u, marker=marker, ms=4, color=colour, capsize=2, label=f"{hz:g} Hz")
        descriptions.append(f"{value.min():.4g} to {value.max():.4g} {unit} at {hz:g} Hz")
    axes.set(xlabel="depth (mm)", ylabel=f"{quantity} ({unit})")
    if quantity == "amplitude":
        axes.set_ylim(0, None)
    legend(axes, "above", MAX_CURVES)
    alt = (
        f"{quantity.title()} in {len(gates)} gates from {depth_mm[0]:.4g} to {depth_mm[-1]:.4g} mm: "
        f"{'; '.join(descriptions)}."
    )
    return picture(figure, f"depth-{quantity}", f"{quantity.title()} over depth, bars of 2 u", alt)


def _motion(gates: Sequence[GateResult]) -> Picture:
    figure, axes = panel()
    depth_mm, time_ms = np.array([gate.depth_m for gate in gates]) * 1e3, np.array(gates[0].motion_time_s) * 1e3
    no_motion = (np.nan,) * time_ms.size
    # In um: labels of five digits would push the name of the colour bar off the panel.
    motion_um = np.array([gate.motion_m or no_motion for gate in gates]) * 1e6
    limit_um = float(np.nanmax(np.abs(motion_um), initial=0.0)) or 1.0
    axes.set_facecolor("#BBBBBB")
    image = axes.pcolormesh(
        time_ms, depth_mm, motion_um, cmap="RdBu_r", vmin=-limit_um, vmax=limit_um, rasterized=True, shading="nearest"
    )
    bar = figure.colorbar(image)
    bar.set_label("displacement (um)", size=9)
    bar.ax.tick_params(labelsize=9)
    axes.grid(visible=False)
    axes.invert_yaxis()
    axes.set(xlabel="time after a toneburst's arrival (ms)", ylabel="depth (mm)")
    alt = (
        f"Mean displacement within the burst period of {time_ms[-1] + time_ms[0]:.4g} ms in {len(gates)} gates from "
        f"{depth_mm[0]:.4g} to {depth_mm[-1]:.4g} mm, between {np.nanmin(motion_um):.4g} and "
        f"{np.nanmax(motion_um):.4g} um about its mean."
    )
    return picture(figure, "depth-motion", "Motion over depth and burst period", alt)
