"""Checks of the twin that a scene declares: mistakes in [simulation], and settings that differ from the scene's."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any

from hpe_rig.bench.push_scan import push_scan_mistakes, scan_file_mistakes
from hpe_rig.bench.twin import TwinDeclaration, twin_of, twin_settings, twin_tables
from hpe_rig.scene import Mistake, Scene, mistakes_of

SLOW_HARMONICS = 56
"""Number of harmonics of nonlinear propagation above which a push takes half a minute or more."""


def check_simulation(tables: Mapping[str, Any]) -> list[Mistake]:
    """Return the mistakes of ``[simulation]`` in a scene's ``tables``, by the twin's rules."""
    from sim_backend.settings import SimulationSettings

    simulation = tables.get("simulation", {})
    # A [simulation] that is no table is a mistake of the scene, which reports it.
    return mistakes_of(SimulationSettings, simulation, ("simulation",)) if isinstance(simulation, Mapping) else []


def check_declared(scene: Scene) -> list[Mistake]:
    """Return the mistakes of ``[simulation]`` combined with the scene's beams and sound speed, and those of scans."""
    scan = scene.beams.excitation_scan if scene.beams is not None else None
    mistakes = [] if scan is None else push_scan_mistakes(scan)
    if scene.simulation is None:
        return mistakes
    simulation_mistakes = check_simulation({"simulation": twin_tables(scene)})
    return mistakes + (simulation_mistakes or [*_scan_mistakes(scene), *_force_mistakes(scene)])


def _scan_mistakes(scene: Scene) -> list[Mistake]:
    """Return the reasons why scans of the twin's measured beams cannot be read."""
    beams = twin_settings(scene).beams
    if beams.field != "measured":
        return []
    keys = "excitation_scan", "tracking_scan"
    return [mistake for key in keys for mistake in scan_file_mistakes(f"simulation.beams.{key}", getattr(beams, key))]


def _force_mistakes(scene: Scene) -> Iterator[Mistake]:
    """Yield the reason why nonlinear propagation cannot give the force: its computation fails, or it saturates."""
    settings = twin_settings(scene)
    if settings.propagation is None or settings.specimen is None or scene.excitation is None:
        return
    from sim_backend.transducer import push_of

    if settings.propagation.harmonics >= SLOW_HARMONICS:
        _warn_slow(settings.propagation.harmonics)
    # Computed here, so that the failure of a scene is reported before its measurement; the result is cached.
    try:
        push = push_of(settings, scene.excitation.carrier_hz)
    except ValueError as error:
        remedy = "fewer harmonics (24 are accurate to 1 % of the force), or another sound speed or transducer"
        yield Mistake("simulation.propagation", str(error), remedy)
        return
    try:
        if push is not None:
            push.surface_for(settings.specimen.force_density_n_per_m3)
    except ValueError as error:
        yield Mistake("simulation.specimen.force_density_n_per_m3", str(error), "a smaller one, or less nonlinearity")


@cache
def _warn_slow(harmonics: int) -> None:
    """Warn once per process that the push takes long to compute."""
    logging.getLogger("hpe_rig").warning(
        "The push with %d harmonics takes minutes to compute. With 24, good to 1 %% of its force, seconds.",
        harmonics,
    )


def contradictions(scene: Scene) -> Iterator[tuple[str, str, str]]:
    """Yield each key of [beams], [medium] and [sphere] with another value in the twin: key, scene's and twin's value.

    Depths and sound speeds are not compared here, but by the check of the gate's depth.
    """
    twin = twin_of(scene)
    if twin is None:
        return
    for key, declared, simulated in (
        *_beam_values(scene, twin),
        *_medium_values(scene, twin),
        *_sphere_values(scene, twin),
    ):
        if declared != simulated:
            yield key, _setting_text(declared), _setting_text(simulated)


def _beam_values(scene: Scene, twin: TwinDeclaration) -> Iterator[tuple[str, Any, Any]]:
    """Yield the keys of [beams] with the scene's and the twin's value; an absent depth is the twin's."""
    if scene.beams is None:
        return
    declared, simulated = scene.beams, twin.settings.beams
    yield "beams.excitation_width_m", declared.excitation_width_m, simulated.motion_width_m()
    yield "beams.tracking_width_m", declared.tracking_width_m, simulated.tracking_width_m
    yield "beams.focus_depth_m", declared.focus_depth_m or twin.focus_depth_m, twin.focus_depth_m
    yield (
        "beams.push_focus_depth_m",
        declared.push_focus_depth_m or twin.push_focus_depth_m,
        twin.push_focus_depth_m,
    )
    if declared.excitation_scan is not None:
        scan = simulated.excitation_scan if simulated.field == "measured" else None
        yield "beams.excitation_scan", declared.excitation_scan, scan or "none"
    diameter_m = 0.0 if simulated.field == "gaussian" else simulated.transducer.diameter_m
    yield "beams.transducer_diameter_m", declared.transducer_diameter_m or 0.0, diameter_m


def _medium_values(scene: Scene, twin: TwinDeclaration) -> Iterator[tuple[str, Any, Any]]:
    declared, simulated = scene.medium, twin.settings.specimen
    if declared is not None and simulated is not None:
        yield "medium", "voigt", simulated.medium
        for key in ("shear_modulus_pa", "shear_viscosity_pa_s", "density_kg_per_m3"):
            yield f"medium.{key}", getattr(declared, key), getattr(simulated, key)


def _sphere_values(scene: Scene, twin: TwinDeclaration) -> Iterator[tuple[str, Any, Any]]:
    """Yield the keys of [sphere]; a missing sphere has radius 0."""
    declared, specimen = scene.sphere, twin.settings.specimen
    simulated = None if specimen is None else specimen.sphere
    if declared is not None or simulated is not None:
        declared_m = 0.0 if declared is None else declared.radius_m
        yield "sphere.radius_m", declared_m, 0.0 if simulated is None else simulated.radius_m
    if declared is not None and simulated is not None:
        yield "sphere.density_kg_per_m3", declared.density_kg_per_m3, simulated.density_kg_per_m3


def _setting_text(value: Any) -> str:
    """Return a setting as a scene file has it, numbers to four digits."""
    if isinstance(value, tuple):
        return f"[{', '.join(map(_setting_text, value))}]"
    return value if isinstance(value, str) else f"{value:.4g}"
