"""Twin declaration: the simulation that a scene declares, as one typed value; only this module reads [simulation].

If [simulation] has no sound speed or beams, those of the scene's [acquisition] and [beams] apply.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray, Int64Array
from hpe_rig.bench.bench_file import BenchFile
from hpe_rig.scene import Excitation, Scene, current_simulation

if TYPE_CHECKING:
    from sim_backend.motion import Dose
    from sim_backend.settings import SimulationSettings
    from sim_backend.transducer import Push, WaterOutput

_APPLICATION_BEAM_KEYS = {"pulse_length_m", "transducer_diameter_m", "attenuation_db_per_cm_mhz", "excitation_scan"}
"""Keys of [beams] that the twin has no counterpart of."""
REFERENCE_CYCLES = 3
"""Cycles of the tracking pulse for which the twin's echo level is stated."""
MAX_LOSS_DB = 6000.0
"""Bound of an attenuation, which keeps powers of ten within the range of floating-point numbers."""


@dataclass(frozen=True, slots=True)
class TwinDeclaration:
    """The twin that a scene declares, validated, with defaults and presets filled in.

    ``settings`` has everything; the properties and methods follow from it.
    """

    settings: SimulationSettings

    @property
    def sound_speed_m_per_s(self) -> float:
        """Longitudinal sound speed."""
        return self.settings.sound_speed_m_per_s

    @property
    def has_echoes(self) -> bool:
        """Whether there are scatterers or reflectors."""
        from sim_backend.settings import scatterer_count

        scatterers = self.settings.scatterers
        return bool(scatterer_count(scatterers, self.settings.beams) or scatterers.reflectors)

    @property
    def echo_reach_m(self) -> float:
        """Distance from the focus along the beam beyond which nothing echoes."""
        scatterers = self.settings.scatterers
        reach_m = [scatterers.volume_m[2] / 2] if scatterers.per_cell > 0 else [0.0]
        return max(reach_m + [abs(reflector.position_m[2]) for reflector in scatterers.reflectors])

    @property
    def has_noise(self) -> bool:
        """Whether receiver noise is simulated: by its SNR, or by the density at the input of the receive chain."""
        chain = self.settings.receive_chain
        return self.settings.receiver.snr_db is not None if chain is None else chain.noise_v_per_sqrt_hz is not None

    @property
    def noise_v(self) -> float:
        """Root-mean-square noise at the digitizer without receive chain; 0 without noise."""
        receiver = self.settings.receiver
        return 0.0 if receiver.snr_db is None else float(receiver.echo_rms_v * 10 ** (-receiver.snr_db / 20))

    @property
    def jitters_s(self) -> dict[str, float]:
        """Root-mean-square jitter of triggers and of the sampling clock, by key of [simulation.instruments]."""
        instruments = self.settings.instruments
        return {name: getattr(instruments, name) for name in ("trigger_jitter_s", "sample_clock_jitter_s")}

    @property
    def has_clock_errors(self) -> bool:
        """Whether the rates of the instruments' clocks differ; False: all share one reference."""
        instruments = self.settings.instruments
        return any(instruments.clock_error.model_dump().values())

    @property
    def burst_clock_rate(self) -> float:
        """True rate of the burst train's clock over its nominal rate; only the ground truth may use it."""
        return 1 + float(self.settings.instruments.clock_error.burst_train)

    @property
    def rate_error(self) -> float:
        """True relative error of the motion's frequencies by the pulses' clock; only the ground truth may use it."""
        motion_rate = 1.0 if self.prescribed else self.burst_clock_rate
        return motion_rate / (1 + float(self.settings.instruments.clock_error.tracking_train)) - 1

    @property
    def focus_depth_m(self) -> float:
        """Distance from the tracking transducer to the common focus, the centre of the scatterers."""
        return self.settings.beams.tracked_from_m

    @property
    def push_focus_depth_m(self) -> float:
        """Distance from the pushing transducer to the common focus."""
        return self.settings.beams.focus_depth_m

    @property
    def foreign_medium(self) -> str | None:
        """Material law of another package that the specimen has; None for a law of the twin."""
        from sim_backend.settings import BUILT_IN_MEDIA

        medium = None if self.settings.specimen is None else self.settings.specimen.medium
        return None if medium in BUILT_IN_MEDIA else medium

    @property
    def prescribed(self) -> tuple[tuple[float, float], ...]:
        """Frequency, Hz, and amplitude, m, of every prescribed sinusoid."""
        return tuple((motion.frequency_hz, motion.amplitude_m) for motion in self.settings.motion or ())

    def echo_pulse_s(self, carrier_hz: float) -> float:
        """Return the approximate length of one scatterer's echo, the reciprocal of its bandwidth."""
        scatterers = self.settings.scatterers
        centre_hz = scatterers.band_centre_hz if scatterers.pulse == "burst" else carrier_hz
        return 1 / (scatterers.bandwidth * centre_hz)

    def echo_v(self, amplitude_vpp: float, cycles: float, carrier_hz: float, focus_offset_m: float = 0.0) -> float:
        """Return the root-mean-square stationary echo of a tracking pulse at the digitizer without receive chain.

        ``focus_offset_m`` is the distance from the focus to the nearest point of the gate.
        """
        receiver = self.settings.receiver
        # The echo is proportional to the pulse's amplitude and length, ...
        relative_v = amplitude_vpp / receiver.reference_pulse_vpp * cycles / REFERENCE_CYCLES
        # Loss relative to the reference pulse, for which ``echo_rms_v`` is stated.
        loss_db = self.settings.loss_to_focus_db(carrier_hz)
        loss_db -= self.settings.loss_to_focus_db(receiver.reference_carrier_hz)
        # ... to the beam at the gate, and to the attenuation relative to the reference carrier.
        widths = min(focus_offset_m, self.echo_reach_m) / self.settings.beams.tracking_width_m[2]
        relative_v *= math.exp(-(widths**2) / 2)
        return float(receiver.echo_rms_v * relative_v * 10 ** (-min(max(loss_db, -MAX_LOSS_DB), MAX_LOSS_DB) / 20))

    def displacement_m(
        self,
        time_s: FloatArray,
        burst_onset_s: FloatArray,
        burst_length_s: float,
        drive: tuple[float, float] | None,
    ) -> FloatArray:
        """Return the displacement (time,) at the focus at ``time_s`` after the master trigger, background included.

        ``burst_onset_s`` (burst,) is at the transducer; ``drive`` is carrier, Hz, and amplitude, Vpp, of tonebursts.
        """
        background_m = self.background_m(time_s)
        displacement_m = np.zeros(time_s.shape) if background_m is None else background_m
        time_ps = np.rint(time_s * 1e12).astype(np.int64)
        if drive is not None and burst_onset_s.size:
            displacement_m = displacement_m + self._pushed_m(time_ps, burst_onset_s, burst_length_s, drive)
        if self.settings.motion:
            from sim_backend.motion import motion_at

            return displacement_m + motion_at(self.settings.motion, time_ps)
        return displacement_m

    def _pushed_m(
        self, time_ps: Int64Array, burst_onset_s: FloatArray, burst_length_s: float, drive: tuple[float, float]
    ) -> FloatArray:
        """Return the displacement (time,) at the focus due to the tonebursts, m."""
        from sim_backend.motion import focus_response, force_shape, radiation_force, transient_displacement
        from sim_backend.wiring import Bursts

        settings, specimen = self.settings, self.settings.specimen
        if specimen is None:
            return np.zeros(time_ps.shape)
        # Only bursts before the last time matter.
        onset_ps = np.rint(burst_onset_s[burst_onset_s * 1e12 <= time_ps[-1]] * 1e12).astype(np.int64)
        # Equal tonebursts.
        carrier_hz, amplitude_vpp = (np.full(onset_ps.shape, value) for value in drive)
        length_ps = round(burst_length_s * 1e12)
        bursts = Bursts(onset_ps, onset_ps + length_ps, carrier_hz, burst_length_s * carrier_hz, amplitude_vpp)
        response = focus_response(specimen, force_shape(settings))
        travel_s = settings.beams.focus_depth_m / settings.sound_speed_m_per_s
        force = radiation_force(bursts, specimen, travel_s)
        return np.asarray(transient_displacement(response, force, time_ps))

    def background_m(self, time_s: FloatArray) -> FloatArray | None:
        """Return the displacement (time,) of the whole specimen, m; None if it is at rest.

        ``time_s`` (time,) counts from the master trigger.
        """
        if not self.settings.background:
            return None
        from sim_backend.motion import background_at

        time_ps = np.rint(time_s * 1e12)
        if np.any(np.abs(time_ps) >= 2.0**63):
            raise OverflowError(f"a time of {np.max(np.abs(time_s)):.3g} s, beyond the twin's clock of 106 days")
        return background_at(self.settings.background, time_ps.astype(np.int64))

    def prescribed_phasor_m(self, frequency_hz: float, start_s: float = 0.0) -> complex:
        """Return A exp(j phase), m, of the prescribed motion A sin(2 pi f t + phase) at exactly ``frequency_hz``.

        Time t starts ``start_s`` after the master trigger, where the phases of the settings count from. Components of
        equal frequency add up.
        """
        phasor_m = 0j
        for motion in self.settings.motion or ():
            if math.isclose(motion.frequency_hz, frequency_hz):
                phase_rad = motion.phase_rad + 2 * math.pi * (motion.frequency_hz * start_s % 1)
                phasor_m += motion.amplitude_m * cmath.exp(1j * phase_rad)
        return phasor_m

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

        None without specimen, and if it moves by the Gaussian of eq. (12) instead of the medium's shear field.
        """
        specimen = self.settings.specimen
        if specimen is None or specimen.field == "gaussian":
            return None
        from sim_backend.motion import shear_modulus

        s_per_s = np.asarray(2j * np.pi * frequency_hz, np.complex128)
        return np.asarray(shear_modulus(specimen, s_per_s)), specimen.density_kg_per_m3

    def dose(self, excitation: Excitation, burst_length_s: float, frequency_hz: FloatArray) -> Dose | None:
        """Return the specimen's dose and its largest possible displacement at ``frequency_hz`` (frequency,).

        None without specimen, and for a sphere: the force on its surface is not that on an attenuating medium.
        """
        specimen = self.settings.specimen
        if specimen is None or specimen.sphere is not None:
            return None
        from sim_backend.motion import dose, force_shape

        train = excitation.burst_rate_hz, burst_length_s
        force, speed_m_per_s = force_shape(self.settings), self.sound_speed_m_per_s
        return dose(specimen, force, *train, frequency_hz, speed_m_per_s, excitation.carrier_hz)

    def push(self, carrier_hz: float) -> Push | None:
        """Return the push as a function of drive; None with linear propagation."""
        if self.settings.propagation is None:
            return None
        from sim_backend.transducer import push_of

        return push_of(self.settings, carrier_hz)

    def water_output(self, surface_pa: float, carrier_hz: float) -> WaterOutput | None:
        """Return the output that a hydrophone would measure in water for ``surface_pa`` at the transducer.

        None with linear propagation.
        """
        if self.settings.propagation is None:
            return None
        from sim_backend.transducer import water_output

        return water_output(self.settings, surface_pa, carrier_hz)

    def depth_shift_m(self, bench: BenchFile, trigger_delay_s: float) -> float:
        """Return how much deeper than planned the record is, due to latencies other than in the bench file."""
        simulated, board, pulser = self.settings.instruments, bench.digitizer, bench.generators.tracking_pulser
        # Delay of sample 0 after the pulse: the twin's, minus the one that the plan assumed.
        shift_s = simulated.digitizer_latency_s - simulated.aux_latency_s - simulated.generator_latency_s
        shift_s -= board.latency_s - board.aux_latency_s - pulser.latency_s
        if simulated.aux_waits_for_trigger_delay and not board.aux_waits_for_trigger_delay:
            shift_s -= trigger_delay_s
        return float(shift_s * self.sound_speed_m_per_s / 2)

    def max_records(self, bench: BenchFile, record_samples: int) -> float:
        """Return how many records of a capture fit into the twin's board; inf if they are read during the capture."""
        instruments, board = self.settings.instruments, bench.digitizer
        count = board.board_model.most_records(instruments.samples_per_channel, record_samples)
        streams = instruments.dual_port_memory and board.mode != "single_port"
        return math.inf if streams and count else count


def twin_of(scene: Scene) -> TwinDeclaration | None:
    """Return the twin that ``scene`` declares; None without [simulation], or with an invalid one on a real bench."""
    if scene.simulation is None:
        return None
    try:
        return TwinDeclaration(twin_settings(scene))
    except ValueError:
        # A simulated bench reports every mistake when the scene is loaded; a real one does not read the section.
        return None


def twin_settings(scene: Scene) -> SimulationSettings:
    """Return the twin's settings, with its defaults for absent keys; raise ``ValueError`` for an invalid twin."""
    from sim_backend.settings import SimulationSettings

    return SimulationSettings.model_validate(twin_tables(scene))


def twin_tables(scene: Scene) -> dict[str, Any]:
    """Return the tables of the twin's settings that a scene declares."""
    # A new scene has no removed key: `check_simulation` refuses it.
    simulation = current_simulation(scene.simulation or {})
    # [simulation] takes precedence over the scene's sound speed and beams.
    beams = {} if scene.beams is None else scene.beams.model_dump(exclude=_APPLICATION_BEAM_KEYS, exclude_none=True)
    if "push_focus_depth_m" in beams:
        # The twin's focus_depth_m is the distance from the pushing transducer.
        beams |= {"tracking_focus_depth_m": beams["focus_depth_m"], "focus_depth_m": beams.pop("push_focus_depth_m")}
    sound_speed = {"sound_speed_m_per_s": scene.acquisition.sound_speed_m_per_s}
    return sound_speed | simulation | {"beams": beams | simulation.get("beams", {})}


def simulation_schema() -> dict[str, Any]:
    """Return the JSON schema of the ``[simulation]`` section."""
    from sim_backend.settings import SimulationSettings

    return SimulationSettings.model_json_schema()
