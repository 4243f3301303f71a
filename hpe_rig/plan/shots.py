"""Shots of a scene with every edge in absolute time; a function of scene and bench file alone."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from drivers.interfaces import Capture, PulseTrain, Toneburst, TriggerPulse
from hpe_rig.arrays import FloatArray
from hpe_rig.bench import EXCITATION_ROLES, GENERATOR_ROLES, BenchFile
from hpe_rig.plan.omitted import Omission, omissions
from hpe_rig.scene import Mistake, Scene, SettingsError

TTL_HIGH_V = 4.0
MASTER_PULSE_S = 10e-6
MOST_SHOTS = 20_000
MOST_PULSES = 1_000_000
SAFETY_MARGIN_S = 1.0
"""How much later than planned the digitizer's deadline stands, beyond the trains themselves."""


@dataclass(frozen=True, slots=True)
class Timeline:
    """Instants of one shot at the transducer, in seconds after the master trigger's edge.

    ``burst_onset_s`` (burst,), ``pulse_onset_s`` (pulse,); the gate and the record of pulse k stand
    ``gate_offset_s`` and ``record_offset_s`` (start, end) after ``pulse_onset_s[k]``. ``push_later_s``: how much longer
    sound takes to the gate from the transducer that pushes than from the one that tracks. ``reference_offset_s``: start
    and end of the reference gate, where there is one.
    """

    burst_onset_s: FloatArray
    burst_length_s: float
    pulse_onset_s: FloatArray
    pulse_length_s: float
    gate_offset_s: tuple[float, float]
    record_offset_s: tuple[float, float]
    push_later_s: float = 0.0
    reference_offset_s: tuple[float, float] | None = None

    @property
    def heard_offset_s(self) -> tuple[float, float]:
        """From when to when after a pulse its echoes count: from the start of the first gate to the end of the last."""
        own, other = self.gate_offset_s, self.reference_offset_s or self.gate_offset_s
        return min(own[0], other[0]), max(own[1], other[1])

    @property
    def sensing_s(self) -> FloatArray:
        """When each tracking pulse reaches the middle of the gate and senses its motion, shape (pulse,)."""
        return self.pulse_onset_s + self._way_s

    @property
    def reference_s(self) -> float:
        """Phase reference: arrival of the first toneburst at the gate, or the master's edge where nothing pushes."""
        return float(self.burst_onset_s[0]) + self._way_s + self.push_later_s if self.burst_onset_s.size else 0.0

    @property
    def _way_s(self) -> float:
        return sum(self.gate_offset_s) / 4


@dataclass(frozen=True, slots=True)
class Shot:
    """One master trigger: what every instrument is programmed to, and when what happens."""

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
    """Where the tracking transducer stands beside the push."""
    axial_offset_m: float = 0.0
    point: int = 0
    """Number of the scene's point that it is of, where the scene sweeps any numbers."""

    @property
    def gate(self) -> slice:
        """Samples of the record that lie in the gate."""
        rate_hz, start_s = self.capture.sample_rate_hz, self.timeline.record_offset_s[0]
        first = round((self.timeline.gate_offset_s[0] - start_s) * rate_hz)
        length = round((self.timeline.gate_offset_s[1] - self.timeline.gate_offset_s[0]) * rate_hz)
        return slice(first, first + length)

    def force_fraction_at(self, amplitude_vpp: float) -> float:
        """Return the force over F_0 when the toneburst generator is set to ``amplitude_vpp``; NaN where nothing pushes.

        An instrument rounds what it is sent; the force is proportional to the square of what it holds.
        """
        if self.force_fraction is None or self.toneburst is None:
            return math.nan
        share = amplitude_vpp / self.toneburst.amplitude_vpp
        return self.force_fraction if math.isclose(share, 1.0) else self.force_fraction * share**2

    @property
    def train_end_s(self) -> float:
        """End of both trains after the master trigger's edge."""
        tracking, burst = self.tracking_train, self.burst_train
        ends = [tracking.delay_s + tracking.count / tracking.rate_hz]
        return max(ends + ([burst.count / burst.rate_hz] if burst else []))


@dataclass(frozen=True, slots=True)
class Plan:
    """Everything a measurement will do."""

    roles: tuple[str, ...]
    shots: tuple[Shot, ...]
    shot_period_s: float
    omitted: tuple[Omission, ...]
    stops_when_changed: bool = True

    @property
    def places_m(self) -> tuple[float, ...]:
        """Where the tracking transducer stands beside the push, in the order of the shots."""
        return tuple(dict.fromkeys(shot.lateral_offset_m for shot in self.shots))

    @property
    def duration_s(self) -> float:
        """Expected time of the measurement: the shots without the instruments' programming."""
        return self.shot_period_s * (len(self.shots) - 1) + self.shots[-1].train_end_s

    @property
    def record_bytes(self) -> int:
        """Expected size of the records in the run file before any compression."""
        captures = [shot.capture for shot in self.shots]
        return sum(2 * one.record_count * one.record_samples * one.channels for one in captures)


def make_plan(scene: Scene, bench: BenchFile) -> Plan:
    """Return the plan of ``scene`` on ``bench``; it may hold conflicts, which ``hpe_rig.plan.checks`` finds.

    Raises ``SettingsError`` where the scene asks for more shots or pulses than anyone could wait for.
    """
    if scene.sweep.axes:
        return _of_points(scene, bench)
    if len(scene.places) > 1:
        return _joined([make_plan(each, bench) for each in scene.places])
    (scene,) = scene.places
    if len(scene.rates) > 1:
        return _joined([make_plan(each, bench) for each in scene.rates])
    (scene,) = scene.rates
    _refuse_endless(scene)
    shots = tuple(_shots(scene, bench))
    period_s = scene.acquisition.shot_period_s or max(shot.train_end_s for shot in shots)
    roles = tuple(role for role in GENERATOR_ROLES if scene.excitation or role not in EXCITATION_ROLES)
    stops = scene.acquisition.changed_settings == "stop"
    return Plan((*roles, "digitizer"), shots, period_s, tuple(omissions(scene, bench)), stops)


def _of_points(scene: Scene, bench: BenchFile) -> Plan:
    """Return the plan of a sweep over any numbers, as one; raise where its records would not go into one file."""
    plans, shots = [], 0
    for number, point in enumerate(scene.points):
        plan = make_plan(point.scene, bench.with_(point.bench))
        plans.append(replace(plan, shots=tuple(replace(shot, point=number) for shot in plan.shots)))
        shots += len(plan.shots)
        if shots > MOST_SHOTS:
            what = f"its points have more than {MOST_SHOTS} shots, which is the most that a run holds"
            raise SettingsError("the sweep", [Mistake("sweep", what, "fewer values, or several runs")])
    alike = {_shape(plan.shots[0].capture) for plan in plans}
    if len(alike) > 1:
        listed = "; ".join(sorted(f"{count} of {samples} samples" for count, samples, *_ in alike))
        what = f"its points differ in the records of a shot ({listed}, or rate or range), and a run file has one kind"
        remedy = (
            "tracking.pulse_count and the keys of [acquisition] the same at all points, or a run each: hpe-rig queue"
        )
        raise SettingsError("the sweep", [Mistake("sweep", what, remedy)])
    return _joined(plans)


def _shape(capture: Capture) -> tuple[float, ...]:
    monitor_v = capture.monitor_range_v or 0.0
    return capture.record_count, capture.record_samples, capture.sample_rate_hz, capture.input_range_v, monitor_v


def _joined(plans: list[Plan]) -> Plan:
    """Return one plan of the shots of all; what is omitted is the same in each."""
    shots = tuple(replace(shot, index=index) for index, shot in enumerate(s for plan in plans for s in plan.shots))
    return replace(plans[0], shots=shots, shot_period_s=max(plan.shot_period_s for plan in plans))


def places_of(scene: Scene, plan: Plan) -> Iterator[tuple[Scene, Plan]]:
    """Yield the scene at every point and place of the tracking transducer, with the shots that are taken there."""
    for number, point in enumerate(scene.points):
        for place in point.scene.places:
            where = number, place.tracking.lateral_offset_m, place.tracking.axial_offset_m
            shots = (s for s in plan.shots if (s.point, s.lateral_offset_m, s.axial_offset_m) == where)
            yield place, replace(plan, shots=tuple(shots))


def offsets_beside_m(plan: Plan) -> tuple[float, ...]:
    """Return the distances from the axis, in ascending order, at which the plan tracks beside it."""
    return tuple(sorted({abs(shot.lateral_offset_m) for shot in plan.shots} - {0.0}))


def scene_of(scene: Scene, shot: Shot) -> Scene:
    """Return ``scene`` as it is at the point of its sweep that ``shot`` is of."""
    return scene.points[shot.point].scene


def pulse_count(scene: Scene) -> int:
    """Return the number of tracking pulses: as asked, or as many periods as the burst train lasts."""
    if scene.tracking.pulse_count is not None:
        return scene.tracking.pulse_count
    if scene.excitation is None:
        return 1
    train_s = scene.excitation.burst_count / scene.excitation.burst_rate_hz
    return max(1, math.floor(train_s * scene.tracking.pulse_rate_hz + 1e-6))


def reference_gate(scene: Scene, shot: Shot) -> slice | None:
    """Return the samples of a record that lie in the reference gate, None where the scene has none."""
    depth_m = scene.processing.reference_gate_depth_m
    if depth_m is None:
        return None
    acquisition = scene.acquisition
    length_m = scene.processing.reference_gate_length_m or acquisition.gate_length_m
    per_metre = 2 / acquisition.sound_speed_m_per_s * shot.capture.sample_rate_hz
    shift = round((depth_m - length_m / 2 - scene.gate_depth_m + acquisition.gate_length_m / 2) * per_metre)
    start = shot.gate.start + shift
    return slice(start, start + round(length_m * per_metre))


def tracking_path_s(bench: BenchFile) -> tuple[float, float]:
    """Return the time from the master's edge, without t_d, to the digitizer's trigger and to the pulse's onset."""
    generators, board = bench.generators, bench.digitizer
    trigger_s = bench.path_delay_s("master.output", "tracking_train.trigger") + generators.tracking_train.latency_s
    trigger_s += bench.path_delay_s("tracking_train.output", "digitizer.trigger")
    onset_s = trigger_s + board.aux_latency_s + bench.path_delay_s("digitizer.aux", "tracking_pulser.trigger")
    onset_s += generators.tracking_pulser.latency_s + bench.path_delay_s("tracking_pulser.output", bench.tracked_by)
    return trigger_s, onset_s


def burst_path_s(bench: BenchFile) -> float:
    """Return the time from the master's edge to the first toneburst's onset at the transducer; NaN if not wired."""
    train, toneburst = bench.generators.burst_train, bench.generators.toneburst
    if train is None or toneburst is None:
        return math.nan
    to_train_s = bench.path_delay_s("master.output", "burst_train.trigger") + train.latency_s
    to_toneburst_s = bench.path_delay_s("burst_train.output", "toneburst.trigger") + toneburst.latency_s
    return to_train_s + to_toneburst_s + bench.path_delay_s("toneburst.output", "transducer.drive")


def _refuse_endless(scene: Scene) -> None:
    excitation, mistakes = scene.excitation, []
    bursts = len(excitation.burst_length_s) * len(excitation.force_fraction) if excitation else 1
    shots = scene.acquisition.repeats * bursts
    if shots > MOST_SHOTS:
        what = f"the scene asks for {shots} shots, a run holds at most {MOST_SHOTS}"
        mistakes.append(Mistake("acquisition.repeats", what, "fewer repeats, or several runs"))
    if excitation and scene.tracking.pulse_count is None:
        pulses = excitation.burst_count / excitation.burst_rate_hz * scene.tracking.pulse_rate_hz
        if not pulses <= MOST_PULSES:
            what = f"the burst train lasts {pulses:.3g} pulse periods, a shot has at most {MOST_PULSES} pulses"
            mistakes.append(Mistake("tracking.pulse_rate_hz", what, "fewer bursts, or tracking.pulse_count"))
    if mistakes:
        raise SettingsError("the scene", mistakes)


def _shots(scene: Scene, bench: BenchFile) -> Iterator[Shot]:
    excitation, tracking, generators = scene.excitation, scene.tracking, bench.generators
    lengths: tuple[float | None, ...] = excitation.burst_length_s if excitation else (None,)
    forces: tuple[float | None, ...] = excitation.force_fraction if excitation else (None,)
    capture, count = _capture(scene, bench), pulse_count(scene)
    # One timeline for all shots of a burst length: long sweeps and many repeats stay small.
    timelines = {length: _timeline(scene, bench, length, capture) for length in lengths}
    pulser = generators.tracking_pulser
    pulse_vpp = pulser.amplitude_vpp or bench.limits.full_drive_vpp
    sweep = itertools.product(lengths, forces, range(scene.acquisition.repeats))
    for index, (burst_length_s, force, repeat) in enumerate(sweep):
        yield Shot(
            index=index,
            repeat=repeat,
            force_fraction=force,
            master=TriggerPulse(MASTER_PULSE_S, TTL_HIGH_V, generators.master.load_ohm),
            burst_train=_burst_train(scene, bench),
            toneburst=_toneburst(scene, bench, burst_length_s, force),
            tracking_train=_train(tracking.pulse_rate_hz, count, tracking.delay_s, generators.tracking_train.load_ohm),
            tracking_pulser=Toneburst(tracking.carrier_hz, tracking.cycles, pulse_vpp, 0.0, pulser.load_ohm),
            capture=capture,
            timeline=timelines[burst_length_s],
            lateral_offset_m=tracking.lateral_offset_m,
            axial_offset_m=tracking.axial_offset_m,
        )


def _train(rate_hz: float, count: int, delay_s: float, load_ohm: float) -> PulseTrain:
    return PulseTrain(rate_hz, count, delay_s, min(10e-6, 0.25 / rate_hz), TTL_HIGH_V, load_ohm)


def _burst_train(scene: Scene, bench: BenchFile) -> PulseTrain | None:
    excitation, generator = scene.excitation, bench.generators.burst_train
    if excitation is None or generator is None:
        return None
    return _train(excitation.burst_rate_hz, excitation.burst_count, 0.0, generator.load_ohm)


def _toneburst(scene: Scene, bench: BenchFile, length_s: float | None, force: float | None) -> Toneburst | None:
    excitation, generator = scene.excitation, bench.generators.toneburst
    if excitation is None or generator is None or length_s is None or force is None:
        return None
    # Force is proportional to intensity, so to the square of the drive.
    amplitude_vpp = bench.limits.full_drive_vpp * math.sqrt(force)
    cycles = max(1, round(length_s * excitation.carrier_hz))
    return Toneburst(excitation.carrier_hz, cycles, amplitude_vpp, 0.0, generator.load_ohm)


def _gate_offset_s(scene: Scene) -> tuple[float, float]:
    return _offset_s(scene, scene.gate_depth_m, scene.acquisition.gate_length_m)


def _reference_offset_s(scene: Scene) -> tuple[float, float] | None:
    depth_m, length_m = scene.processing.reference_gate_depth_m, scene.processing.reference_gate_length_m
    return None if depth_m is None else _offset_s(scene, depth_m, length_m or scene.acquisition.gate_length_m)


def _offset_s(scene: Scene, depth_m: float, length_m: float) -> tuple[float, float]:
    half_s, middle_s = (metres / scene.acquisition.sound_speed_m_per_s for metres in (length_m, 2 * depth_m))
    return middle_s - half_s, middle_s + half_s


def _capture(scene: Scene, bench: BenchFile) -> Capture:
    acquisition, board = scene.acquisition, bench.digitizer
    trigger_s, onset_s = tracking_path_s(bench)
    middle_s = sum(_gate_offset_s(scene)) / 2 + onset_s - trigger_s - board.latency_s
    delay = math.floor(middle_s * acquisition.sample_rate_hz - acquisition.record_samples / 2)
    # Should the pulser wait for the trigger delay, no delay can bring the record closer to the echo.
    delay = 0 if board.aux_waits_for_trigger_delay else max(0, delay)
    # Rounded down: the gate then lies a little later in the record.
    delay -= delay % board.board_model.trigger_delay_multiple
    # What was imported begins where it began.
    delay = delay if bench.recording is None else 0
    return Capture(
        sample_rate_hz=acquisition.sample_rate_hz,
        record_samples=acquisition.record_samples,
        trigger_delay_samples=delay,
        record_count=pulse_count(scene),
        input_range_v=input_range_v(scene, bench),
        trigger_level_v=board.trigger_level_v,
        monitor_range_v=board.monitor_range_v,
    )


def input_range_v(scene: Scene, bench: BenchFile) -> float:
    """Return the range of the echoes' input: the scene's, else the board's smallest that holds the usual 0.8 V."""
    acquisition = scene.acquisition
    if "input_range_v" in acquisition.model_fields_set:
        return acquisition.input_range_v
    return bench.digitizer.board_model.range_from_v(acquisition.input_range_v)


def _timeline(scene: Scene, bench: BenchFile, burst_length_s: float | None, capture: Capture) -> Timeline:
    tracking, excitation = scene.tracking, scene.excitation
    trigger_s, onset_s = tracking_path_s(bench)
    start_s = trigger_s + bench.digitizer.latency_s + capture.trigger_delay_samples / capture.sample_rate_hz - onset_s
    start_s = start_s if bench.recording is None else bench.recording.first_sample_s
    bursts = np.arange(excitation.burst_count if excitation else 0, dtype=np.float64)
    burst_rate_hz = excitation.burst_rate_hz if excitation else 1.0
    return Timeline(
        burst_onset_s=burst_path_s(bench) + bursts / burst_rate_hz,
        burst_length_s=burst_length_s or 0.0,
        pulse_onset_s=onset_s + tracking.delay_s + np.arange(capture.record_count) / tracking.pulse_rate_hz,
        pulse_length_s=tracking.cycles / tracking.carrier_hz,
        gate_offset_s=_gate_offset_s(scene),
        reference_offset_s=_reference_offset_s(scene),
        record_offset_s=(start_s, start_s + capture.record_samples / capture.sample_rate_hz),
        push_later_s=0.0 if scene.beams is None else scene.beams.push_farther_m / scene.acquisition.sound_speed_m_per_s,
    )
