"""Shots of a scene with every edge in absolute time; a function of scene and bench file only."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers.interfaces import Capture, PulseTrain, Toneburst, TriggerPulse
from hpe_rig.arrays import FloatArray
from hpe_rig.bench import EXCITATION_ROLES, GENERATOR_ROLES, BenchFile
from hpe_rig.plan.omitted import Omission, omissions
from hpe_rig.scene import Mistake, Scene, SettingsError

TTL_HIGH_V = 4.0
MAX_TRIGGER_PULSE_S = 10e-6
"""Length of a trigger pulse; a quarter of the period in fast trains."""
MAX_SHOTS = 20_000
MAX_PULSES = 1_000_000
SAFETY_MARGIN_S = 1.0
"""Time from the planned end of the trains to the digitizer's deadline."""


@dataclass(frozen=True, slots=True)
class Timeline:
    """Times of one shot at the transducer, in seconds after the master trigger's edge.

    ``burst_onset_s`` (burst,) and ``pulse_onset_s`` (pulse,). Gate and record of pulse k are from start to end
    ``gate_offset_s`` and ``record_offset_s`` after ``pulse_onset_s[k]``, the reference gate ``reference_offset_s``.
    ``push_delay_s`` is the travel time to the gate from the pushing transducer minus that from the tracking one.
    """

    burst_onset_s: FloatArray
    burst_length_s: float
    pulse_onset_s: FloatArray
    pulse_length_s: float
    gate_offset_s: tuple[float, float]
    record_offset_s: tuple[float, float]
    push_delay_s: float = 0.0
    reference_offset_s: tuple[float, float] | None = None

    @property
    def listening_offset_s(self) -> tuple[float, float]:
        """Start of the first gate and end of the last one after a pulse, the reference gate included."""
        gate, reference = self.gate_offset_s, self.reference_offset_s or self.gate_offset_s
        return min(gate[0], reference[0]), max(gate[1], reference[1])

    @property
    def sensing_s(self) -> FloatArray:
        """Time (pulse,) when each tracking pulse reaches the centre of the gate and senses its motion."""
        return self.pulse_onset_s + self._travel_s

    @property
    def time_zero_s(self) -> float:
        """Physical time zero: arrival of the first toneburst at the gate, or the master's edge without tonebursts."""
        return float(self.burst_onset_s[0]) + self._travel_s + self.push_delay_s if self.burst_onset_s.size else 0.0

    @property
    def _travel_s(self) -> float:
        """One-way travel time between the tracking transducer and the centre of the gate."""
        return sum(self.gate_offset_s) / 4


@dataclass(frozen=True, slots=True)
class Shot:
    """One master trigger: the task of every instrument, and the times that follow.

    ``lateral_offset_m`` and ``axial_offset_m`` are those of the tracking transducer and the gate; ``point`` is the
    index of the scene's point in a sweep. ``is_control``: the control of the shot before it, of force 0. Its toneburst
    generator is programmed and triggered as in that shot, with the output off.
    """

    index: int
    repeat: int
    force_fraction: float | None
    master: TriggerPulse
    burst_train: PulseTrain | None
    toneburst: Toneburst | None
    tracking_train: PulseTrain
    tracking_pulser: Toneburst
    capture: Capture
    timeline: Timeline
    lateral_offset_m: float = 0.0
    axial_offset_m: float = 0.0
    point: int = 0
    is_control: bool = False

    @property
    def gate(self) -> slice:
        """Samples of the record that are in the gate."""
        rate_hz, start_s = self.capture.sample_rate_hz, self.timeline.record_offset_s[0]
        first = round((self.timeline.gate_offset_s[0] - start_s) * rate_hz)
        length = round((self.timeline.gate_offset_s[1] - self.timeline.gate_offset_s[0]) * rate_hz)
        return slice(first, first + length)

    def force_fraction_at(self, amplitude_vpp: float) -> float:
        """Return the force over F_0 at the toneburst amplitude that an instrument read back; NaN without tonebursts.

        Instruments round amplitudes; the force is proportional to the square of the amplitude.
        """
        if self.force_fraction is None or self.toneburst is None:
            return math.nan
        ratio = amplitude_vpp / self.toneburst.amplitude_vpp
        return self.force_fraction if math.isclose(ratio, 1.0) else self.force_fraction * ratio**2

    @property
    def train_end_s(self) -> float:
        """End of both trains after the master trigger's edge."""
        tracking, burst = self.tracking_train, self.burst_train
        tracking_end_s = tracking.delay_s + tracking.count / tracking.rate_hz
        return max(tracking_end_s, burst.count / burst.rate_hz) if burst else tracking_end_s


@dataclass(frozen=True, slots=True)
class Plan:
    """All actions of a measurement."""

    roles: tuple[str, ...]
    shots: tuple[Shot, ...]
    shot_period_s: float
    omitted: tuple[Omission, ...]
    stops_on_changed_settings: bool = True

    @property
    def lateral_offsets_m(self) -> tuple[float, ...]:
        """Lateral offsets of the tracking transducer, in the order of the shots."""
        return tuple(dict.fromkeys(shot.lateral_offset_m for shot in self.shots))

    @property
    def duration_s(self) -> float:
        """Expected duration of the shots, without programming the instruments."""
        return self.shot_period_s * (len(self.shots) - 1) + self.shots[-1].train_end_s

    @property
    def record_bytes(self) -> int:
        """Expected size of the records in the run file before compression."""
        captures = [shot.capture for shot in self.shots]
        return sum(2 * item.record_count * item.record_samples * item.channels for item in captures)


def make_plan(scene: Scene, bench: BenchFile) -> Plan:
    """Return the plan of ``scene`` on ``bench``; it may contain conflicts, which ``check_plan`` finds.

    Raises ``SettingsError`` if the scene asks for more than ``MAX_SHOTS`` shots or ``MAX_PULSES`` pulses.
    """
    if scene.sweep.axes:
        return _plan_of_points(scene, bench)
    # Nested expansion: points, then offsets, then pulse rates; each inner plan numbers its shots anew.
    if len(scene.places) > 1:
        return _joined([make_plan(offset_scene, bench) for offset_scene in scene.places])
    (scene,) = scene.places
    if len(scene.rates) > 1:
        return _joined([make_plan(rate_scene, bench) for rate_scene in scene.rates])
    (scene,) = scene.rates
    _refuse_too_many(scene)
    shots = tuple(_shots(scene, bench))
    period_s = scene.acquisition.shot_period_s or max(shot.train_end_s for shot in shots)
    roles = tuple(role for role in GENERATOR_ROLES if scene.excitation or role not in EXCITATION_ROLES)
    stops = scene.acquisition.changed_settings == "stop"
    return Plan((*roles, "digitizer"), shots, period_s, tuple(omissions(scene, bench)), stops)


def _plan_of_points(scene: Scene, bench: BenchFile) -> Plan:
    """Return one plan of all points of a sweep; raise if their records do not fit into one file."""
    plans, count = [], 0
    for index, point in enumerate(scene.points):
        plan = make_plan(point.scene, bench.with_(point.bench))
        plans.append(replace(plan, shots=tuple(replace(shot, point=index) for shot in plan.shots)))
        count += len(plan.shots)
        # Inside the loop, because a plan of too many shots would exhaust the memory.
        if count > MAX_SHOTS:
            what = f"its points have more than {MAX_SHOTS} shots, which is the most that a run holds"
            raise SettingsError("the sweep", [Mistake("sweep", what, "fewer values, or several runs")])
    captures = (plan.shots[0].capture for plan in plans)
    shapes = {
        (item.record_count, item.record_samples, item.sample_rate_hz, item.input_range_v, item.monitor_range_v or 0.0)
        for item in captures
    }
    if len(shapes) > 1:
        listed = "; ".join(sorted(f"{count} of {samples} samples" for count, samples, *_ in shapes))
        what = f"its points differ in the records of a shot ({listed}, or rate or range), and a run file has one kind"
        remedy = "equal tracking.pulse_count and keys of [acquisition] at all points, or a run each: hpe-rig queue"
        raise SettingsError("the sweep", [Mistake("sweep", what, remedy)])
    return _joined(plans)


def _joined(plans: Sequence[Plan]) -> Plan:
    """Return one plan with the shots of all plans; their omissions are equal."""
    shots = (shot for plan in plans for shot in plan.shots)
    numbered = tuple(replace(shot, index=index) for index, shot in enumerate(shots))
    # The longest period suits all shots.
    return replace(plans[0], shots=numbered, shot_period_s=max(plan.shot_period_s for plan in plans))


def plans_at_offsets(scene: Scene, plan: Plan) -> Iterator[tuple[Scene, Plan]]:
    """Yield the scene at every point and offset of the tracking transducer, with the shots there."""
    for index, point in enumerate(scene.points):
        for offset_scene in point.scene.places:
            offsets = index, offset_scene.tracking.lateral_offset_m, offset_scene.tracking.axial_offset_m
            shots = (shot for shot in plan.shots if (shot.point, shot.lateral_offset_m, shot.axial_offset_m) == offsets)
            yield offset_scene, replace(plan, shots=tuple(shots))


def control_shots(plan: Plan) -> dict[int, Shot]:
    """Return the control of each shot that has one, by the index of that shot."""
    return {shot.index: control for shot, control in itertools.pairwise(plan.shots) if control.is_control}


def off_axis_offsets_m(plan: Plan) -> tuple[float, ...]:
    """Return the tracked distances from the axis, without 0, in ascending order."""
    return tuple(sorted({abs(shot.lateral_offset_m) for shot in plan.shots} - {0.0}))


def scene_of_shot(scene: Scene, shot: Shot) -> Scene:
    """Return ``scene`` at the point of its sweep to which ``shot`` belongs."""
    return scene.points[shot.point].scene


def pulse_count(scene: Scene) -> int:
    """Return the number of tracking pulses: as set, or as many periods as the burst train lasts."""
    return scene.tracking.pulse_count or scene.burst_train_pulses or 1


def reference_gate(scene: Scene, shot: Shot) -> slice | None:
    """Return the samples of a record that are in the reference gate, None if the scene has none."""
    depth_m = scene.processing.reference_gate_depth_m
    if depth_m is None:
        return None
    acquisition = scene.acquisition
    length_m = scene.processing.reference_gate_length_m or acquisition.gate_length_m
    samples_per_m = 2 / acquisition.sound_speed_m_per_s * shot.capture.sample_rate_hz
    shift = round((depth_m - length_m / 2 - scene.gate_depth_m + acquisition.gate_length_m / 2) * samples_per_m)
    start = shot.gate.start + shift
    return slice(start, start + round(length_m * samples_per_m))


def tracking_path_s(bench: BenchFile) -> tuple[float, float]:
    """Return the delays, without t_d, from the master's edge to the digitizer's trigger and to the pulse's onset."""
    generators, board = bench.generators, bench.digitizer
    trigger_s = bench.path_delay_s("master.output", "tracking_train.trigger") + generators.tracking_train.latency_s
    trigger_s += bench.path_delay_s("tracking_train.output", "digitizer.trigger")
    onset_s = trigger_s + board.aux_latency_s + bench.path_delay_s("digitizer.aux", "tracking_pulser.trigger")
    onset_s += generators.tracking_pulser.latency_s + bench.path_delay_s("tracking_pulser.output", bench.tracked_by)
    return trigger_s, onset_s


def burst_path_s(bench: BenchFile) -> float:
    """Return the delay from the master's edge to the first toneburst's onset at the transducer; NaN if not wired."""
    train, toneburst = bench.generators.burst_train, bench.generators.toneburst
    if train is None or toneburst is None:
        return math.nan
    to_train_s = bench.path_delay_s("master.output", "burst_train.trigger") + train.latency_s
    to_toneburst_s = bench.path_delay_s("burst_train.output", "toneburst.trigger") + toneburst.latency_s
    return to_train_s + to_toneburst_s + bench.path_delay_s("toneburst.output", "transducer.drive")


def _refuse_too_many(scene: Scene) -> None:
    excitation, mistakes = scene.excitation, []
    bursts = len(excitation.burst_length_s) * len(excitation.force_fraction) if excitation else 1
    shots = scene.acquisition.repeats * bursts * (1 + scene.acquisition.control)
    if shots > MAX_SHOTS:
        what = f"the scene asks for {shots} shots, a run holds at most {MAX_SHOTS}"
        mistakes.append(Mistake("acquisition.repeats", what, "fewer repeats, or several runs"))
    if excitation and scene.tracking.pulse_count is None:
        pulses = excitation.burst_count / excitation.burst_rate_hz * scene.tracking.pulse_rate_hz
        if not pulses <= MAX_PULSES:
            what = f"the burst train lasts {pulses:.3g} pulse periods, a shot has at most {MAX_PULSES} pulses"
            mistakes.append(Mistake("tracking.pulse_rate_hz", what, "fewer bursts, or tracking.pulse_count"))
    if mistakes:
        raise SettingsError("the scene", mistakes)


def _shots(scene: Scene, bench: BenchFile) -> Iterator[Shot]:
    """Yield a shot for every burst length, force and repeat, each followed by its control if the scene asks for it."""
    excitation, tracking, generators = scene.excitation, scene.tracking, bench.generators
    lengths_s: tuple[float | None, ...] = excitation.burst_length_s if excitation else (None,)
    forces: tuple[float | None, ...] = excitation.force_fraction if excitation else (None,)
    capture = _capture(scene, bench)
    # All shots of a burst length share one timeline, which keeps long sweeps and many repeats small.
    timelines = {length_s: _timeline(scene, bench, length_s, capture) for length_s in lengths_s}
    pulser = generators.tracking_pulser
    pulse_vpp = pulser.amplitude_vpp or bench.limits.full_drive_vpp
    train_load_ohm = generators.tracking_train.load_ohm
    is_control = (False, True) if scene.acquisition.control else (False,)
    settings = itertools.product(lengths_s, forces, range(scene.acquisition.repeats), is_control)
    for index, (burst_length_s, force, repeat, control) in enumerate(settings):
        yield Shot(
            index=index,
            repeat=repeat,
            force_fraction=0.0 if control else force,
            master=TriggerPulse(MAX_TRIGGER_PULSE_S, TTL_HIGH_V, generators.master.load_ohm),
            burst_train=_burst_train(scene, bench),
            toneburst=_toneburst(scene, bench, burst_length_s, force),
            tracking_train=_train(tracking.pulse_rate_hz, capture.record_count, tracking.delay_s, train_load_ohm),
            tracking_pulser=Toneburst(tracking.carrier_hz, tracking.cycles, pulse_vpp, 0.0, pulser.load_ohm),
            capture=capture,
            timeline=timelines[burst_length_s],
            lateral_offset_m=tracking.lateral_offset_m,
            axial_offset_m=tracking.axial_offset_m,
            is_control=control,
        )


def _train(rate_hz: float, count: int, delay_s: float, load_ohm: float) -> PulseTrain:
    return PulseTrain(rate_hz, count, delay_s, min(MAX_TRIGGER_PULSE_S, 0.25 / rate_hz), TTL_HIGH_V, load_ohm)


def _burst_train(scene: Scene, bench: BenchFile) -> PulseTrain | None:
    excitation, generator = scene.excitation, bench.generators.burst_train
    if excitation is None or generator is None:
        return None
    return _train(excitation.burst_rate_hz, excitation.burst_count, 0.0, generator.load_ohm)


def _toneburst(scene: Scene, bench: BenchFile, length_s: float | None, force: float | None) -> Toneburst | None:
    excitation, generator = scene.excitation, bench.generators.toneburst
    if excitation is None or generator is None or length_s is None or force is None:
        return None
    # The force is proportional to the intensity, hence to the square of the drive.
    amplitude_vpp = bench.limits.full_drive_vpp * math.sqrt(force)
    # A generator counts whole cycles; a check of the plan refuses other lengths.
    cycles = max(1, round(length_s * excitation.carrier_hz))
    return Toneburst(excitation.carrier_hz, cycles, amplitude_vpp, 0.0, generator.load_ohm)


def _offset_s(scene: Scene, depth_m: float, length_m: float | None = None) -> tuple[float, float]:
    """Return start and end of a gate's echoes after the onset of their pulse; default: of the scene's gate length."""
    # Echo time 2 z / c at depth z.
    lengths_m = length_m or scene.acquisition.gate_length_m, 2 * depth_m
    half_s, centre_s = (metres / scene.acquisition.sound_speed_m_per_s for metres in lengths_m)
    return centre_s - half_s, centre_s + half_s


def _capture(scene: Scene, bench: BenchFile) -> Capture:
    acquisition, board = scene.acquisition, bench.digitizer
    return Capture(
        sample_rate_hz=acquisition.sample_rate_hz,
        record_samples=acquisition.record_samples,
        trigger_delay_samples=_trigger_delay_samples(scene, bench),
        record_count=pulse_count(scene),
        input_range_v=input_range_v(scene, bench),
        trigger_level_v=board.trigger_level_v,
        monitor_range_v=board.monitor_range_v,
    )


def _trigger_delay_samples(scene: Scene, bench: BenchFile) -> int:
    """Return the delay of the record after its trigger that centres it on the gate, as the board accepts it."""
    acquisition, board = scene.acquisition, bench.digitizer
    # A pulser that waits for the trigger delay moves with it, and an imported record begins where it began.
    if board.aux_waits_for_trigger_delay or bench.recording is not None:
        return 0
    trigger_s, onset_s = tracking_path_s(bench)
    centre_s = sum(_offset_s(scene, scene.gate_depth_m)) / 2 + onset_s - trigger_s - board.latency_s
    delay = max(0, math.floor(centre_s * acquisition.sample_rate_hz - acquisition.record_samples / 2))
    # Rounded down to the board's steps: the gate then is a little later in the record.
    return delay - delay % board.board_model.trigger_delay_multiple


def input_range_v(scene: Scene, bench: BenchFile) -> float:
    """Return the range of the echoes' input: the scene's, or the board's smallest that includes the default."""
    acquisition = scene.acquisition
    if "input_range_v" in acquisition.model_fields_set:
        return acquisition.input_range_v
    return bench.digitizer.board_model.range_from_v(acquisition.input_range_v)


def _timeline(scene: Scene, bench: BenchFile, burst_length_s: float | None, capture: Capture) -> Timeline:
    tracking, excitation = scene.tracking, scene.excitation
    trigger_s, onset_s = tracking_path_s(bench)
    # Start of the record after the pulse's onset.
    start_s = trigger_s + bench.digitizer.latency_s + capture.trigger_delay_samples / capture.sample_rate_hz - onset_s
    start_s = start_s if bench.recording is None else bench.recording.first_sample_s
    bursts = np.arange(excitation.burst_count if excitation else 0, dtype=np.float64)
    burst_rate_hz = excitation.burst_rate_hz if excitation else 1.0
    reference_m, reference_length_m = scene.processing.reference_gate_depth_m, scene.processing.reference_gate_length_m
    return Timeline(
        burst_onset_s=burst_path_s(bench) + bursts / burst_rate_hz,
        burst_length_s=burst_length_s or 0.0,
        pulse_onset_s=onset_s + tracking.delay_s + np.arange(capture.record_count) / tracking.pulse_rate_hz,
        pulse_length_s=tracking.cycles / tracking.carrier_hz,
        gate_offset_s=_offset_s(scene, scene.gate_depth_m),
        reference_offset_s=None if reference_m is None else _offset_s(scene, reference_m, reference_length_m),
        record_offset_s=(start_s, start_s + capture.record_samples / capture.sample_rate_hz),
        push_delay_s=0.0 if scene.beams is None else scene.beams.push_farther_m / scene.acquisition.sound_speed_m_per_s,
    )
