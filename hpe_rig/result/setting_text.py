"""Settings of shots and of means over repeats, as texts for titles, legends and columns."""

from __future__ import annotations

from collections.abc import Sequence

from hpe_rig.result.repeats import RepeatMean
from hpe_rig.result.values import ShotResult

_SETTINGS = (
    ("burst_length_s", 1e6, "T_b\nus", "g", "T_b = {} us"),
    ("force_fraction", 1.0, "F\nF_0", "", "F = {} F_0"),
    ("pulse_rate_hz", 1.0, "f_prf\nHz", "g", "f_prf = {} Hz"),
    ("window_length_s", 1e3, "T_s\nms", "g", "T_s = {} ms"),
    ("lateral_offset_m", 1e3, "lateral\nmm", "g", "{} mm lateral offset"),
    ("axial_offset_m", 1e3, "axial\nmm", "+g", "{} mm axial offset"),
)
"""Settings that can differ between shots: attribute, scale, header, format, and text in a title.

A force has the format "": that of ``_force_format``.
"""
FORCE_FORMAT = ".4g"
"""A force follows from the voltage of a generator, which is set with four digits."""


def setting_table(items: Sequence[ShotResult | RepeatMean]) -> list[dict[str, str]]:
    """Return the texts of the settings of every shot or mean by name; "" for absent ones and offsets of zero in all.

    Forces have more digits if two of them had equal texts.
    """
    form_of_force = _force_format(items)
    on_axis = {name for name, *_ in _SETTINGS if name.endswith("offset_m") and not any(getattr(i, name) for i in items)}
    tables = []
    for item in items:
        table = {}
        for name, factor, _, form, text in _SETTINGS:
            value = getattr(item, name)
            is_stated = value is not None and name not in on_axis
            table[name] = text.format(format(value * factor, form or form_of_force)) if is_stated else ""
        tables.append(table | {name: f"{name} = {value:g}" for name, value in item.swept.items()})
    return tables


def setting_texts(item: ShotResult | RepeatMean) -> list[str]:
    """Return the settings of a shot or mean for a title."""
    return [text for text in setting_table([item])[0].values() if text]


def _force_format(items: Sequence[ShotResult | RepeatMean]) -> str:
    """Return the format of the relative forces of ``items``: with more digits if two forces had equal texts."""
    forces = {item.force_fraction for item in items if item.force_fraction is not None}
    return FORCE_FORMAT if len({format(force, FORCE_FORMAT) for force in forces}) == len(forces) else "g"


def control_text(shots: Sequence[ShotResult]) -> str:
    """Return in words the largest motion in the controls of ``shots``, "" without controls."""
    motions = [estimate for shot in shots for estimate in shot.control]
    if not motions:
        return ""
    largest = max(motions, key=lambda item: item.amplitude_m)
    controls = len({shot.index for shot in shots if shot.control})
    where = "the control" if controls == 1 else f"{controls} controls"
    amplitude_nm, u_nm = largest.tracked_amplitude_m * 1e9, largest.tracked_amplitude_uncertainty_m * 1e9
    return (
        f"motion in {where} with tonebursts off, subtracted: "
        f"at most {amplitude_nm:.3g} nm (u {u_nm:.2g} nm) at {largest.frequency_hz:g} Hz"
    )


def common_settings(items: Sequence[ShotResult] | Sequence[RepeatMean]) -> str:
    """Return the settings that are equal in all ``items``, for a title."""
    first, *further = setting_table(items)
    return "".join(f", {text}" for name, text in first.items() if text and all(item[name] == text for item in further))


def varied_settings(items: Sequence[ShotResult] | Sequence[RepeatMean]) -> tuple[list[str], list[list[str]]]:
    """Return the headers of the settings that differ between ``items``, and their cells (item, header)."""
    format_of_force = _force_format(items)
    cells = {
        header: [_cell(getattr(item, name), factor, form or format_of_force) for item in items]
        for name, factor, header, form, _ in _SETTINGS
    }
    # Keys of a sweep are shortened to their last part.
    for name in items[0].swept:
        cells[f"{name.rpartition('.')[2]}\n"] = [f"{item.swept[name]:g}" for item in items]
    varied = [header for header, texts in cells.items() if len(set(texts)) > 1]
    return varied, [[cells[header][index] for header in varied] for index in range(len(items))]


def _cell(value: float | None, factor: float, form: str) -> str:
    return "-" if value is None else format(value * factor, form.removeprefix("+"))
