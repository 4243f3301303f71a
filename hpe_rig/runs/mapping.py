"""Map of a recording with many lines: amplitude, phase and velocity over lines and depths, without a run file."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from hpe_rig.recordings import Recording, Source, as_source, read_recording, read_settings
from hpe_rig.result import MotionMap
from hpe_rig.runs.arguments import known_laws, require_numbers
from hpe_rig.runs.importing import stated_by_scene
from hpe_rig.scene import (
    UNSTATED_FREQUENCY_ACCURACY,
    Mistake,
    Scene,
    SceneSource,
    SettingsError,
    edited_text,
    parse_scene,
    parse_toml,
    path_of,
    scene_text,
)

if TYPE_CHECKING:
    from hpe_rig.moduli import ModuliResult

UNUSED_RATE_HZ = 1000.0
"""Pulse rate of a scene that states none; any rate gives the same moduli."""


def map_motion(
    recording: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] | ArrayLike,
    scene: SceneSource,
    *,
    sidecar: str | os.PathLike[str] | None = None,
    progress: Callable[[int, int], None] | None = None,
    **settings: Any,
) -> MotionMap:
    """Return amplitude, phase and velocity with their uncertainties at every line and depth of ``recording``.

    ``recording`` is a file or an array of echoes, described as for ``import_records``; by default all lines are mapped.
    Gates of the scene's ``acquisition.gate_length_m`` follow each other from the first sample on. I and Q are pixels:
    a gate has at least one sample. So is every series of a displacement or velocity (``quantity``); its uncertainty is
    that of ``estimate_motion``. Frequencies are the scene's. ``progress`` gets the number of lines done and the
    total. A pixel without an echo above the noise is marked and NaN. If Numba has been imported, compiled functions are
    used, and results differ by rounding. Raises ``SettingsError`` with every mistake of recording, sidecar or scene.

    >>> motion_map = map_motion("rf.npz", "my-scene.toml", axes="line,pulse,sample", line_pitch_m=0.3e-3)
    >>> motion_map.to_xarray().amplitude_m.sel(frequency=200.0)
    >>> motion_map.figure().savefig("map.png")
    """
    sidecar_file = None if sidecar is None else Path(sidecar)
    return map_recording(as_source(recording), scene, sidecar_file, settings, progress)[0]


def fit_map_moduli(
    motion_map: MotionMap, scene: SceneSource, *, laws: Sequence[str] = (), width_uncertainty: float = 0.05
) -> ModuliResult:
    """Return the moduli of the medium fitted to the lines of a map in the depth of the focus.

    ``scene`` states tonebursts and [beams]. Positions of the lines count from the push, phases from the onset of a
    toneburst (``first_pulse_s``). ``laws`` and ``width_uncertainty``: as for ``fit_moduli``. At most 12 lines, evenly
    spread, are fitted. Raises ``SettingsError`` if geometry, push or motion do not allow a fit.

    >>> fit_map_moduli(map_motion("shear.npz", "push.toml", quantity="displacement_um"), "push.toml", laws=["voigt"])
    """
    from hpe_rig.moduli import moduli_of_map

    fitted_laws = known_laws("fit_map_moduli", laws)
    require_numbers("fit_map_moduli", width_uncertainty=width_uncertainty)
    name, text = scene_text(scene)
    tracking = parse_toml(text, f"scene {name}").get("tracking", {})
    if isinstance(tracking, dict) and "pulse_rate_hz" not in tracking:
        # Every scene needs a rate; that of the recording is unknown after the map.
        text = edited_text(text, {path_of("tracking.pulse_rate_hz"): UNUSED_RATE_HZ})
    try:
        return moduli_of_map(motion_map, parse_scene(name, text).scene, fitted_laws, width_uncertainty)
    except ValueError as error:
        what, _, remedy = str(error).partition(" Try: ")
        mistake = Mistake("", what.rstrip("."), remedy or "another scene or recording")
        raise SettingsError("moduli of the map", [mistake]) from error


def map_recording(
    source: Source,
    scene: SceneSource,
    sidecar: Path | None = None,
    options: dict[str, Any] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[MotionMap, tuple[str, ...]]:
    """Return the map of ``source`` and a description of all inferred values; raises as ``map_motion``."""
    from hpe_rig.processing import map_pixels, map_stated_motion

    name, text = scene_text(scene)
    settings, origins = read_settings(source if isinstance(source, Path) else None, sidecar, options)
    recording = read_recording(source, settings, origins, stated_by_scene(name, text), for_map=True)
    if recording.values.shape[1] != 1:
        what = f"a map needs one shot, the recording has {recording.values.shape[1]}"
        raise SettingsError(f"recording {recording.name}", [Mistake("axes", what, "one of them, or hpe-rig import")])
    recorded_scene = _as_recorded(name, text, recording)
    if not recorded_scene.wanted_frequencies_hz:
        what = "the scene has no vibration frequency"
        raise SettingsError(f"scene {name}", [Mistake("processing.frequencies_hz", what, "[200.0]")])
    try:
        series = recording.values[:, 0], recording.pulse_time_s, recorded_scene.wanted_frequencies_hz
        if recording.quantity is None:
            settings_of_map = _map_settings(recorded_scene, recording)
            motion_map = map_pixels(*series, settings_of_map, recording.line_position_m, progress)
        else:
            if "estimator" in recorded_scene.processing.model_fields_set:
                estimator = recorded_scene.processing.estimator
                what = f"{estimator!r} estimates motion from echoes, and the recording holds a {recording.quantity}"
                raise SettingsError(f"scene {name}", [Mistake("processing.estimator", what, "a scene without it")])
            stated = recorded_scene.processing.frequency_accuracy
            motion_map = map_stated_motion(
                *series,
                recording.quantity,
                recording.depth_m,
                recording.line_position_m,
                frequency_accuracy=UNSTATED_FREQUENCY_ACCURACY if stated is None else stated,
            )
    except ValueError as error:
        what, _, remedy = str(error).rpartition(": ")
        mistake = Mistake("", what or str(error), remedy if what else "other settings")
        raise SettingsError(f"recording {recording.name}", [mistake]) from error
    return replace(motion_map, origin=f"IMPORTED from {recording.name}, SHA-256 {recording.sha256}"), recording.inferred


def _as_recorded(name: str, text: str, recording: Recording) -> Scene:
    """Return the scene with the rates and counts of the recording."""
    values: dict[str, float] = {
        "tracking.pulse_rate_hz": recording.pulse_rate_hz,
        "tracking.pulse_count": recording.values.shape[2],
        "acquisition.record_samples": recording.values.shape[3],
    }
    if recording.quantity is None:
        values["tracking.carrier_hz"] = recording.carrier_hz
        values["acquisition.sample_rate_hz"] = recording.sample_rate_hz
    if recording.sound_speed_m_per_s is not None:
        values["acquisition.sound_speed_m_per_s"] = recording.sound_speed_m_per_s
    return parse_scene(name, edited_text(text, {path_of(key): value for key, value in values.items()})).scene


def _map_settings(scene: Scene, recording: Recording) -> Any:
    from hpe_rig.processing import MapSettings

    acquisition = scene.acquisition
    # Samples per metre of depth: sound travels there and back.
    per_metre = 2 / acquisition.sound_speed_m_per_s * recording.sample_rate_hz
    return MapSettings(
        sample_rate_hz=recording.sample_rate_hz,
        carrier_hz=recording.carrier_hz,
        gate_samples=max(1, round(acquisition.gate_length_m * per_metre)),
        sound_speed_m_per_s=acquisition.sound_speed_m_per_s,
        sound_speed_uncertainty=acquisition.sound_speed_uncertainty,
        first_sample_s=recording.first_sample_s,
        demodulation_hz=recording.demodulation_hz,
    )
