"""Twin declaration: what a scene says of its simulation, as one typed value; only here the raw table is read.

Where ``[simulation]`` is silent about sound speed and beams, the scene's own [acquisition] and [beams] hold.
"""

from __future__ import annotations

import cmath
import logging
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray, Int64Array
from hpe_rig.scene import Mistake, Scene, SettingsError, mistakes_of, settings_schema

if TYPE_CHECKING:
    from hpe_rig.bench.bench_file import BenchFile
    from sim_backend.motion import Dose
    from sim_backend.settings import SimulationSettings
    from sim_backend.transducer import Push, Scan, WaterOutput

Intensity = Callable[[FloatArray, FloatArray], FloatArray]
"""Over distances from the axis (lateral,) and from the focus (axial,), in any unit: (axial, lateral)."""

# From here on a push takes half a minute or more.
_LONG_HARMONICS = 56
_OWN_BEAM_KEYS = {"pulse_length_m", "transducer_diameter_m", "attenuation_db_per_cm_mhz", "excitation_scan"}
"""What [beams] says to the application alone."""
MOST_AT_ENDS = 0.25
"""Pressure on the axis, over the focus', that a scan of the push may end with: what is missing then moves a
medium by half a percent, of a Gaussian beam."""
REFERENCE_CYCLES = 3
"""Cycles of the tracking pulse that gives the twin's stated echo."""


@dataclass(frozen=True, slots=True)
class TwinDeclaration:
    """What a scene's twin simulates, validated, defaults and presets filled in.

    ``settings`` holds everything, for those who build a twin; the rest of the application asks the properties.
    """

    settings: SimulationSettings

    @property
    def sound_speed_m_per_s(self) -> float:
        """Longitudinal sound speed."""
        return self.settings.sound_speed_m_per_s

    @property
    def scatterers_per_cell(self) -> float:
        """Scatterers per resolution cell."""
        return self.settings.scatterers.per_cell

    @property
    def snr_db(self) -> float | None:
        """Echo power over noise power in the reference gate; None where it is not stated as a ratio."""
        return self.settings.receiver.snr_db

    @property
    def reference_gate_m(self) -> float:
        """Length of the gate around the focus in which ``snr_db`` holds."""
        return self.settings.receiver.reference_gate_m

    @property
    def has_receive_chain(self) -> bool:
        """Whether filters, switch and amplifiers between transducer and digitizer are simulated."""
        return self.settings.receive_chain is not None

    @property
    def has_noise(self) -> bool:
        """Whether receiver noise is drawn: by its SNR, or by the density at the chain's input."""
        chain = self.settings.receive_chain
        return self.snr_db is not None if chain is None else chain.noise_v_per_sqrt_hz is not None

    @property
    def trigger_jitter_s(self) -> float:
        """Trigger jitter between the sampling clock and a tracking pulse, root mean square."""
        return self.settings.instruments.trigger_jitter_s

    @property
    def jitters_s(self) -> dict[str, float]:
        """Jitter of triggers and of the sampling clock, root mean square, by key of the twin's instruments."""
        instruments = self.settings.instruments
        return {name: getattr(instruments, name) for name in ("trigger_jitter_s", "sample_clock_jitter_s")}

    @property
    def echoes(self) -> bool:
        """Whether there is anything that echoes."""
        from sim_backend.settings import scatterer_count

        scatterers = self.settings.scatterers
        return bool(scatterer_count(scatterers, self.settings.beams) or scatterers.reflectors)

    @property
    def noise_v(self) -> float:
        """Noise at the digitizer without receive chain, root mean square; 0 where none is drawn."""
        receiver = self.settings.receiver
        return 0.0 if receiver.snr_db is None else float(receiver.echo_rms_v * 10 ** (-receiver.snr_db / 20))

    def echo_pulse_s(self, carrier_hz: float) -> float:
        """Return about how long the echo of one scatterer is: one over its bandwidth, or as it was measured."""
        scatterers = self.settings.scatterers
        if scatterers.measured_pulse is not None:
            return len(scatterers.measured_pulse) / scatterers.measured_pulse_rate_hz
        centre_hz = scatterers.band_centre_hz if scatterers.pulse == "burst" else carrier_hz
        return 1 / (scatterers.bandwidth * centre_hz)

    def echo_v(self, amplitude_vpp: float, cycles: float, carrier_hz: float, off_focus_m: float = 0.0) -> float:
        """Return the resting echo of such a tracking pulse at the digitizer without receive chain, root mean square.

        ``off_focus_m``: from the focus to the nearest place in the gate.
        """
        receiver = self.settings.receiver
        strength = amplitude_vpp / receiver.reference_pulse_vpp * cycles / REFERENCE_CYCLES
        if not self.settings.transmitter.linear:
            from sim_backend.acoustics import transmitted_fraction

            strength *= float(transmitted_fraction(np.array([amplitude_vpp]), self.settings)[0])
        lost_db = self.settings.loss_to_focus_db(carrier_hz)
        lost_db -= self.settings.loss_to_focus_db(receiver.reference_carrier_hz)
        widths = min(off_focus_m, self.echo_reach_m) / self.settings.beams.tracking_width_m[2]
        strength *= math.exp(-(widths**2) / 2)
        return float(receiver.echo_rms_v * strength * 10 ** (-min(max(lost_db, -6000.0), 6000.0) / 20))

    def moved_m(
        self,
        time_s: FloatArray,
        burst_onset_s: FloatArray,
        burst_length_s: float,
        drive: tuple[float, float] | None,
    ) -> FloatArray:
        """Return the displacement at the focus ``time_s`` (time,) after the master trigger, background included, m.

        ``burst_onset_s`` (burst,) at the transducer; ``drive``: carrier, Hz, and amplitude, Vpp, of the tonebursts.
        """
        moved_m = self.background_m(time_s)
        moved_m = np.zeros(time_s.shape) if moved_m is None else moved_m
        time_ps = np.rint(time_s * 1e12).astype(np.int64)
        if drive is not None and burst_onset_s.size:
            moved_m = moved_m + self._pushed_m(time_ps, burst_onset_s, burst_length_s, drive)
        if self.settings.motion:
            from sim_backend.motion import motion_at

            return moved_m + motion_at(self.settings.motion, time_ps)
        return moved_m

    def _pushed_m(
        self,
        time_ps: Int64Array,
        burst_onset_s: FloatArray,
        burst_length_s: float,
        drive: tuple[float, float],
    ) -> FloatArray:
        from sim_backend.motion import focus_response, force_shape, radiation_force, transient_displacement
        from sim_backend.wiring import Bursts

        settings, specimen = self.settings, self.settings.specimen
        if specimen is None:
            return np.zeros(time_ps.shape)
        onset_ps = np.rint(burst_onset_s[burst_onset_s * 1e12 <= time_ps[-1]] * 1e12).astype(np.int64)
        carrier_hz, amplitude_vpp = (np.full(onset_ps.shape, value) for value in drive)
        length_ps = round(burst_length_s * 1e12)
        bursts = Bursts(onset_ps, onset_ps + length_ps, carrier_hz, burst_length_s * carrier_hz, amplitude_vpp)
        response = focus_response(specimen, force_shape(settings))
        travel_s = settings.beams.focus_depth_m / settings.sound_speed_m_per_s
        force = radiation_force(bursts, specimen, travel_s, settings.transmitter)
        return np.asarray(transient_displacement(response, force, time_ps))

    def later_m(self, bench: BenchFile, trigger_delay_s: float) -> float:
        """Return how much deeper than planned the record looks: the twin's latencies against the bench file's."""
        own, board, pulser = self.settings.instruments, bench.digitizer, bench.generators.tracking_pulser
        later_s = own.digitizer_latency_s - own.aux_latency_s - own.generator_latency_s
        later_s -= board.latency_s - board.aux_latency_s - pulser.latency_s
        if own.aux_waits_for_trigger_delay and not board.aux_waits_for_trigger_delay:
            later_s -= trigger_delay_s
        return float(later_s * self.sound_speed_m_per_s / 2)

    def most_records(self, bench: BenchFile, record_samples: int) -> float:
        """Return how many records of a capture the twin's board holds; inf where they stream out as they come."""
        own, board = self.settings.instruments, bench.digitizer
        held = board.board_model.most_records(own.samples_per_channel, record_samples)
        streams = own.dual_port_memory and board.mode != "single_port"
        return math.inf if streams and held else held

    @property
    def has_specimen(self) -> bool:
        """Whether a medium is moved by the tonebursts."""
        return self.settings.specimen is not None

    @property
    def foreign_medium(self) -> str | None:
        """Law of another package by which the specimen moves; None where it is one of the twin's own."""
        from sim_backend.settings import OWN_MEDIA

        medium = None if self.settings.specimen is None else self.settings.specimen.medium
        return None if medium in OWN_MEDIA else medium

    @property
    def prescribed(self) -> tuple[tuple[float, float], ...]:
        """Frequency, Hz, and amplitude, m, of every prescribed sinusoid; empty where no motion is prescribed."""
        return tuple((each.frequency_hz, each.amplitude_m) for each in self.settings.motion or ())

    def background_m(self, time_s: FloatArray) -> FloatArray | None:
        """Return how far the whole specimen has moved ``time_s`` (time,) after the master trigger; None: it rests."""
        if not self.settings.background:
            return None
        from sim_backend.motion import background_at

        time_ps = np.rint(time_s * 1e12)
        if np.any(np.abs(time_ps) >= 2.0**63):
            raise OverflowError(f"a time of {np.max(np.abs(time_s)):.3g} s, beyond the twin's clock of 106 days")
        return background_at(self.settings.background, time_ps.astype(np.int64))

    @property
    def focus_depth_m(self) -> float:
        """Distance from the transducer that tracks to the common focus, in the middle of the scatterers."""
        return self.settings.beams.tracked_from_m

    @property
    def push_focus_depth_m(self) -> float:
        """Distance from the transducer that pushes to the common focus."""
        return self.settings.beams.focus_depth_m

    @property
    def echo_reach_m(self) -> float:
        """Distance from the focus, along the beam, beyond which nothing echoes."""
        scatterers = self.settings.scatterers
        reach = [scatterers.volume_m[2] / 2] if scatterers.per_cell > 0 else [0.0]
        return max(reach + [abs(each.position_m[2]) for each in scatterers.reflectors])

    def prescribed_phasor_m(self, frequency_hz: float, start_s: float = 0.0) -> complex:
        """Return A exp(j phase), m, of the prescribed motion at exactly ``frequency_hz``, as A sin(2 pi f t + phase).

        ``t`` from ``start_s`` after the master trigger's edge, from which the components' own phases count; components
        of the same frequency add up, all others leave no trace.
        """
        alike = (each for each in self.settings.motion or () if math.isclose(each.frequency_hz, frequency_hz))
        return sum(
            (
                each.amplitude_m * cmath.exp(1j * (each.phase_rad + 2 * math.pi * (each.frequency_hz * start_s % 1)))
                for each in alike
            ),
            0j,
        )

    def steady_response_m(self, frequency_hz: float) -> float:
        """Return the amplitude at the focus, m, under a sinusoidal force of amplitude F_0; 0 without specimen."""
        specimen = self.settings.specimen
        if specimen is None:
            return 0.0
        from sim_backend.motion import focus_transfer, force_shape

        response = focus_transfer(specimen, force_shape(self.settings), np.array([frequency_hz]))[0]
        return float(abs(response) * specimen.force_density_n_per_m3)

    def medium(self, frequency_hz: FloatArray) -> tuple[ComplexArray, float] | None:
        """Return the specimen's complex shear modulus (frequency,), Pa, and density, kg/m^3.

        None without specimen, and where it moves by the Gaussian of eq. (12) instead of the medium's own field.
        """
        specimen = self.settings.specimen
        if specimen is None or specimen.field == "gaussian":
            return None
        from sim_backend.motion import shear_modulus

        s_per_s = np.asarray(2j * np.pi * frequency_hz, np.complex128)
        return np.asarray(shear_modulus(specimen, s_per_s)), specimen.density_kg_per_m3


def twin_of(scene: Scene) -> TwinDeclaration | None:
    """Return what ``scene`` declares of its twin; None where it declares none, or (on a real bench) an invalid one."""
    if not declares_twin(scene):
        return None
    try:
        return TwinDeclaration(twin_settings(scene))
    except ValueError:
        # On a simulated bench every mistake was reported when the scene was read; a real one does not read the section.
        return None


def contradictions(scene: Scene) -> Iterator[tuple[str, str, str]]:
    """Yield each key of [beams], [medium] and [sphere] that the twin contradicts, the scene's value and the twin's.

    Nothing of what ``twin_of`` has no value for. Depths and sound speeds are compared where the gate is.
    """
    twin = twin_of(scene)
    if twin is None:
        return
    beams, specimen = twin.settings.beams, twin.settings.specimen
    pairs: list[tuple[str, Any, Any]] = []
    if scene.beams is not None:
        pairs.append(("beams.excitation_width_m", scene.beams.excitation_width_m, beams.motion_width_m()))
        pairs.append(("beams.tracking_width_m", scene.beams.tracking_width_m, beams.tracking_width_m))
        pairs.append(("beams.focus_depth_m", scene.beams.focus_depth_m or beams.tracked_from_m, beams.tracked_from_m))
        declared_m = scene.beams.push_focus_depth_m or beams.focus_depth_m
        pairs.append(("beams.push_focus_depth_m", declared_m, beams.focus_depth_m))
        if (scan := scene.beams.excitation_scan) is not None:
            of_twin = beams.excitation_scan if beams.field == "measured" else None
            pairs.append(("beams.excitation_scan", scan, of_twin or "none"))
        across_m = 0.0 if beams.field == "gaussian" else beams.transducer.diameter_m
        pairs.append(("beams.transducer_diameter_m", scene.beams.transducer_diameter_m or 0.0, across_m))
    if scene.medium is not None and specimen is not None:
        names = "shear_modulus_pa", "shear_viscosity_pa_s", "density_kg_per_m3"
        pairs.append(("medium", "voigt", specimen.medium))
        pairs += [(f"medium.{name}", getattr(scene.medium, name), getattr(specimen, name)) for name in names]
    ball = None if specimen is None else specimen.sphere
    if scene.sphere is not None or ball is not None:
        declared_m = 0.0 if scene.sphere is None else scene.sphere.radius_m
        pairs.append(("sphere.radius_m", declared_m, 0.0 if ball is None else ball.radius_m))
    if scene.sphere is not None and ball is not None:
        pairs.append(("sphere.density_kg_per_m3", scene.sphere.density_kg_per_m3, ball.density_kg_per_m3))
    for key, declared, simulated in pairs:
        if declared != simulated:
            yield key, _written(declared), _written(simulated)


def _written(value: Any) -> str:
    """Return a setting as a scene file has it, numbers to four digits."""
    if isinstance(value, tuple):
        return f"[{', '.join(map(_written, value))}]"
    return value if isinstance(value, str) else f"{value:.4g}"


def declares_twin(scene: Scene) -> bool:
    """Return whether the scene has a ``[simulation]`` section, valid or not."""
    return scene.simulation is not None


def twin_settings(scene: Scene) -> SimulationSettings:
    """Return the twin's settings, its defaults where ``scene`` is silent; raise ``ValueError`` for an invalid twin."""
    from sim_backend.settings import SimulationSettings

    return SimulationSettings.model_validate(twin_tables(scene))


def twin_tables(scene: Scene) -> dict[str, Any]:
    """Return the tables of the twin's settings that a scene declares."""
    simulation = scene.simulation or {}
    beams = {} if scene.beams is None else scene.beams.model_dump(exclude=_OWN_BEAM_KEYS, exclude_none=True)
    if "push_focus_depth_m" in beams:
        # the twin's own word for the focus is the distance from where it is pushed
        beams |= {"tracking_focus_depth_m": beams["focus_depth_m"], "focus_depth_m": beams.pop("push_focus_depth_m")}
    declared = {"sound_speed_m_per_s": scene.acquisition.sound_speed_m_per_s}
    return declared | simulation | {"beams": beams | simulation.get("beams", {})}


def twin_dose(scene: Scene, burst_length_s: float, frequency_hz: FloatArray) -> Dose | None:
    """Return the simulated specimen's dose and what it could move at ``frequency_hz``; None without or of a sphere."""
    from sim_backend.motion import dose, force_shape

    twin = twin_of(scene)
    if twin is None or twin.settings.specimen is None or scene.excitation is None:
        return None
    if twin.settings.specimen.sphere is not None:
        # Its force is that on a surface, not what an intensity does to a medium that attenuates.
        return None
    train = scene.excitation.burst_rate_hz, burst_length_s
    force, speed = force_shape(twin.settings), twin.sound_speed_m_per_s
    return dose(twin.settings.specimen, force, *train, frequency_hz, speed, scene.excitation.carrier_hz)


def twin_push(scene: Scene) -> Push | None:
    """Return the simulated push over drive; None where it propagates linearly or nothing is pushed."""
    twin = twin_of(scene)
    if twin is None or twin.settings.propagation is None or scene.excitation is None:
        return None
    from sim_backend.transducer import push_of

    return push_of(twin.settings, scene.excitation.carrier_hz)


def twin_water_output(scene: Scene, surface_pa: float) -> WaterOutput | None:
    """Return what a hydrophone would find in water with ``surface_pa`` at the transducer; None where it is linear."""
    twin = twin_of(scene)
    if twin is None or twin.settings.propagation is None or scene.excitation is None:
        return None
    from sim_backend.transducer import water_output

    return water_output(twin.settings, surface_pa, scene.excitation.carrier_hz)


def check_simulation(tables: Mapping[str, Any]) -> list[Mistake]:
    """Return the mistakes of ``[simulation]`` in a scene's ``tables``, by the twin's own rules."""
    from sim_backend.settings import SimulationSettings

    simulation = tables.get("simulation", {})
    # What is no table at all is the scene's own mistake.
    return mistakes_of(SimulationSettings, simulation, ("simulation",)) if isinstance(simulation, Mapping) else []


def check_declared(scene: Scene) -> list[Mistake]:
    """Return the mistakes of ``[simulation]`` together with what the scene declares of beams and sound speed."""
    declared = scene.beams.excitation_scan if scene.beams is not None else None
    found = [] if declared is None else _unfit(declared)
    if not declares_twin(scene):
        return found
    simulated = check_simulation({"simulation": twin_tables(scene)})
    return found + (simulated or [*_unreadable_scans(scene), *_force_too_large(scene)])


def _unreadable_scans(scene: Scene) -> list[Mistake]:
    """Return what keeps the scans of measured beams from being read."""
    beams = twin_settings(scene).beams
    if beams.field != "measured":
        return []
    names = ("excitation_scan", "tracking_scan")
    return [each for name in names for each in _unreadable(f"simulation.beams.{name}", getattr(beams, name))]


def _unreadable(key: str, path: str) -> list[Mistake]:
    from sim_backend.transducer import read_scan

    try:
        read_scan(path)
    except (OSError, ValueError) as error:
        lost = not Path(path).is_file()
        remedy = "the file there, or beside the run file" if lost else "a scan as docs/explanation/transducer.md describes"
        return [Mistake(key, str(error), remedy)]
    return []


def _unfit(path: str) -> list[Mistake]:
    """Return what keeps the scan in ``path`` from being the force of a push."""
    from sim_backend.transducer import read_scan

    if mistakes := _unreadable("beams.excitation_scan", path):
        return mistakes
    return [
        Mistake(
            "beams.excitation_scan",
            f"the scan {path} ends at z_m = {end_m:g}, where the pressure on the axis is still {value:.0%} of the "
            "focus': the push goes on, its force would not",
            f"a scan to where the pressure falls below {MOST_AT_ENDS:.0%}",
        )
        for end_m, value in _at_ends(read_scan(path))
        if value > MOST_AT_ENDS
    ]


@lru_cache(maxsize=8)
def _at_ends(scan: Scan) -> tuple[tuple[float, float], ...]:
    """Return where a scan begins and ends along the axis, and its pressure on the axis there over the focus'."""
    from sim_backend.transducer import round_field

    along_m = scan.place_m[:, 2]
    ends_m = np.array([along_m.min(), along_m.max()])
    # the size of a mean around the axis is the same whatever the wave number
    size = np.abs(round_field(scan, 0.0, np.zeros(1), ends_m)[:, 0])
    return tuple(zip(ends_m.tolist(), size.tolist(), strict=True))


def scanned_push(path: str, frequency_hz: float, sound_speed_m_per_s: float) -> Intensity:
    """Return the intensity of the beam that a hydrophone scanned; the same function as long as the file stays the same.

    Raises ``SettingsError`` where the file cannot be read or the scan cuts the push.
    """
    if mistakes := _unfit(path):
        raise SettingsError("the scene", mistakes)
    from sim_backend.transducer import read_scan

    return _intensity_of(read_scan(path), 2 * math.pi * frequency_hz / sound_speed_m_per_s)


@lru_cache(maxsize=8)
def _intensity_of(scan: Scan, wave_number_per_m: float) -> Intensity:
    from sim_backend.transducer import round_field

    return lambda lateral_m, axial_m: np.abs(round_field(scan, wave_number_per_m, lateral_m, axial_m)) ** 2


def _force_too_large(scene: Scene) -> Iterator[Mistake]:
    """Yield what keeps the push from its force where it propagates nonlinearly: its own computation, or the drive."""
    settings = twin_settings(scene)
    if settings.propagation is None or settings.specimen is None or scene.excitation is None:
        return
    from sim_backend.transducer import push_of

    if settings.propagation.harmonics >= _LONG_HARMONICS:
        _say_long(settings.propagation.harmonics)
    try:
        push = push_of(settings, scene.excitation.carrier_hz)
    except ValueError as error:
        remedy = "fewer harmonics (24 are good to 1 % of the force), or another sound speed or transducer"
        yield Mistake("simulation.propagation", str(error), remedy)
        return
    try:
        if push is not None:
            push.surface_for(settings.specimen.force_density_n_per_m3)
    except ValueError as error:
        yield Mistake("simulation.specimen.force_density_n_per_m3", str(error), "a smaller one, or less nonlinearity")


@cache
def _say_long(harmonics: int) -> None:
    """Say once that the push takes its time."""
    logging.getLogger("hpe_rig").warning(
        "The push with %d harmonics takes minutes to compute. With 24, good to 1 %% of its force, seconds.",
        harmonics,
    )


def simulation_schema() -> dict[str, Any]:
    """Return the JSON schema of the ``[simulation]`` section."""
    from sim_backend.settings import SimulationSettings

    return settings_schema(SimulationSettings)
