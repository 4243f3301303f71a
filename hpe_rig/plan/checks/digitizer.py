"""Checks of the digitizer: settings that its driver refuses, the gate in the record, memory."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from drivers.alazar import BoardModel, mistakes
from drivers.interfaces import Capture
from hpe_rig.bench import BenchFile, twin_of
from hpe_rig.plan.checks.check_result import CheckResult, in_hz, pass_or_refuse
from hpe_rig.plan.interference import pulse_kinds
from hpe_rig.plan.selection import select
from hpe_rig.plan.shots import Plan, reference_gate
from hpe_rig.scene import Scene

MIN_GATE_SAMPLES = 8
MIN_CARRIER_PERIODS = 2.0
"""Periods of the carrier in a gate that the phase of an echo needs."""
SPARE_SAMPLES = 16
"""Samples at either end of a record that a following gate does not reach."""
MAX_MOTION_IN_GATE = 0.25
"""Background motion, relative to the gate's length, up to which a fixed gate measures the same echoes."""


def gate_in_record(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield whether gate and reference gate are in the record, and the gate is long enough."""
    shot, model = plan.shots[0], bench.digitizer.board_model
    gate, samples = shot.gate, shot.capture.record_samples
    text = f"the gate takes samples {gate.start} to {gate.stop} of a record of {samples}"
    # A record that begins too late grows at both ends, as it is centred on the gate.
    needed = gate.stop if gate.start >= 0 else gate.stop - gate.start + 2 * model.record_multiple
    longer = _allowed_record_samples(needed, model)
    remedy = f"acquisition.record_samples = {longer} or more, or a shorter acquisition.gate_length_m"
    yield pass_or_refuse("gate in record", gate.start >= 0 and gate.stop <= samples, text, remedy)
    reference = reference_gate(scene, shot)
    if reference is not None:
        text = f"the reference gate takes samples {reference.start} to {reference.stop} of a record of {samples}"
        remedy = "processing.reference_gate_depth_m closer to acquisition.gate_depth_m, "
        remedy += "or more acquisition.record_samples"
        inside = reference.start >= 0 and reference.stop <= samples
        yield pass_or_refuse("reference gate in record", inside, text, remedy)
    length = gate.stop - gate.start
    remedy = "a longer acquisition.gate_length_m or a higher sample rate"
    yield pass_or_refuse("gate samples", length >= MIN_GATE_SAMPLES, f"the gate holds {length} samples", remedy)
    periods = length / shot.capture.sample_rate_hz * scene.tracking.carrier_hz
    if periods < MIN_CARRIER_PERIODS:
        text = f"the gate holds {periods:.2g} periods of tracking.carrier_hz, and the phase of an echo needs at least "
        remedy = "a longer acquisition.gate_length_m or a higher tracking.carrier_hz"
        yield CheckResult("gate periods", "refused", f"{text}{MIN_CARRIER_PERIODS:g}", remedy)


def background(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield whether the declared background motion stays in the gate, or in the record if the gate follows it."""
    shot, acquisition = plan.shots[0], scene.acquisition
    gate, samples, follows = shot.gate, shot.capture.record_samples, scene.processing.follow_gate
    samples_per_m = 2 / acquisition.sound_speed_m_per_s * shot.capture.sample_rate_hz
    margin_m = min(gate.start, samples - gate.stop) / samples_per_m
    margin_text = f"acquisition.record_samples = {samples} lets the gate follow by {margin_m * 1e3:.3g} mm"
    twin = twin_of(scene) if bench.simulated else None
    motion_m = None if twin is None else twin.background_m(shot.timeline.sensing_s[select(scene, shot).window])
    if motion_m is None or not motion_m.size:
        if follows:
            yield CheckResult("gate follows", "passed", margin_text)
        return
    # The gate starts where the specimen is at the first pulse.
    farthest_m = float(np.abs(motion_m - motion_m[0]).max())
    motion_text = f"the background moves by {farthest_m * 1e3:.3g} mm in the processing window"
    if not follows:
        text = f"{motion_text}, the gate is {acquisition.gate_length_m * 1e3:.3g} mm long"
        if farthest_m < MAX_MOTION_IN_GATE * acquisition.gate_length_m:
            yield CheckResult("background", "passed", text)
        else:
            yield CheckResult("background", "warning", text, "processing.follow_gate = true")
        return
    longest = gate.stop - gate.start + 2 * math.ceil(farthest_m * samples_per_m) + 2 * SPARE_SAMPLES
    needed = _allowed_record_samples(longest, bench.digitizer.board_model)
    remedy = f"acquisition.record_samples = {needed}, or a shorter processing.window_length_s"
    yield pass_or_refuse("gate follows", farthest_m <= margin_m, f"{margin_text}, {motion_text}", remedy)
    text = f"the background is {abs(motion_m[0]) * 1e3:.3g} mm off the focus at the first pulse"
    remedy = "another simulation.background phase_rad or processing.window_start_s: the gate begins at the focus"
    yield pass_or_refuse("gate at focus", abs(motion_m[0]) < acquisition.gate_length_m / 2, text, remedy)


def trigger_times(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield a warning if nothing in the records shows lost and stray triggers: NPT records have no trigger times."""
    if bench.digitizer.mode != "npt":
        return
    near = int(np.count_nonzero(pulse_kinds(plan.shots[0])))
    text = (
        f"acquisition_mode = npt records no trigger times, and {near} records coincide with a toneburst or its echoes"
    )
    if near:
        yield CheckResult("trigger times", "passed", f"{text}, which show lost and stray triggers")
    else:
        remedy = 'acquisition_mode = "traditional"'
        yield CheckResult("trigger times", "warning", f"{text}: a stray trigger shifts later records unnoticed", remedy)


def board(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield whether the board accepts the settings of the records, and samples the carrier.

    The driver decides; settings without a separate check are reported in the driver's words.
    """
    capture, model, carrier_hz = plan.shots[0].capture, bench.digitizer.board_model, scene.tracking.carrier_hz
    refused = mistakes(_without_monitor(capture), model)
    checks = _record_checks(capture, model)
    for field, (check, text, remedy) in checks.items():
        yield pass_or_refuse(check, all(mistake.field != field for mistake in refused), text, remedy)
    for mistake in refused:
        if mistake.field not in checks:
            yield CheckResult("digitizer", "refused", mistake.text, f"{_KEYS[mistake.field]} within that")
    nyquist_hz = capture.sample_rate_hz / 2
    text = f"tracking.carrier_hz = {in_hz(carrier_hz)}, half the sampling rate is {in_hz(nyquist_hz)}"
    remedy = f"acquisition.sample_rate_hz above {in_hz(2 * carrier_hz)}"
    yield pass_or_refuse("carrier", carrier_hz < nyquist_hz, text, remedy)


_KEYS = {"record_count": "tracking.pulse_count", "trigger_level_v": "digitizer.trigger_level_v"}
"""Settings key by field of ``Capture``, for fields without a check."""


def _choice(values: Sequence[float]) -> str:
    """Return the accepted ``values`` in words."""
    return f"{'one of ' if len(values) > 1 else ''}{', '.join(f'{value:g}' for value in values)}"


def _record_checks(capture: Capture, model: BoardModel) -> dict[str, tuple[str, str, str]]:
    """Return name, text and remedy of each check, by the field of ``Capture`` that it concerns."""
    rates = _choice([rate / 1e6 for rate in model.sample_rates_hz])
    ranges = _choice(model.input_ranges_v)
    samples, multiples = capture.record_samples, f"multiples of {model.record_multiple} from {model.record_minimum}"
    delay, longest = capture.trigger_delay_samples, model.max_trigger_delay_samples
    return {
        "sample_rate_hz": (
            "sample rate",
            f"acquisition.sample_rate_hz = {in_hz(capture.sample_rate_hz)} on the {model.name}",
            f"{rates} MHz",
        ),
        "input_range_v": (
            "input range",
            f"acquisition.input_range_v = {capture.input_range_v:g} V on the {model.name}",
            f"{ranges} V",
        ),
        "record_samples": (
            "record length",
            f"acquisition.record_samples = {samples}, the {model.name} takes {multiples}",
            f"acquisition.record_samples = {_allowed_record_samples(samples, model)}",
        ),
        "trigger_delay_samples": (
            "trigger delay",
            f"trigger delay of {delay} samples, the board holds {longest}",
            "a gate nearer to the transducer",
        ),
    }


def _allowed_record_samples(samples: int, model: BoardModel) -> int:
    """Return the shortest record of at least ``samples`` that the board accepts."""
    return max(model.record_minimum, model.record_multiple * math.ceil(samples / model.record_multiple))


def _without_monitor(capture: Capture) -> Capture:
    return replace(capture, monitor_range_v=None)


def capture_mode(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield whether the board can capture in the bench file's mode, with both channels if both are recorded."""
    settings, capture = bench.digitizer, plan.shots[0].capture
    channels = "channel A" if capture.channels == 1 else "channels A and B"
    text = f"digitizer.acquisition_mode = {settings.mode}, {channels}"
    if settings.mode != "single_port" and not settings.has_dual_port_memory:
        remedy = 'acquisition_mode = "single_port", or dual_port_memory = true if the board has it'
        yield CheckResult("capture mode", "refused", f"{text}: needs dual-port memory", remedy)
    # Mistakes with one channel in the default mode are reported by the check of the board.
    reported = mistakes(_without_monitor(capture), settings.board_model)
    refused = [item for item in mistakes(capture, settings.board_model, settings.mode) if item not in reported]
    remedy = "another digitizer.acquisition_mode, monitor_range_v or acquisition.record_samples"
    for mistake in refused:
        yield CheckResult("capture mode", "refused", f"{text}: {mistake.text}", remedy)
    if not refused:
        yield CheckResult("capture mode", "passed", text)


def memory(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield whether the records of a shot fit into the board's memory, if they are read only after the shot."""
    settings, capture = bench.digitizer, plan.shots[0].capture
    if settings.mode != "single_port":
        text = f"{capture.record_count} records stream through dual-port memory"
        yield CheckResult("memory", "passed", text)
        return
    model = settings.board_model
    limit = min(settings.max_records, model.most_records(settings.samples_per_channel, capture.record_samples))
    text = f"{capture.record_count} records of {capture.record_samples} samples, the board holds {limit}"
    remedy = f"tracking.pulse_count of at most {limit}, or shorter acquisition.record_samples"
    if limit == settings.max_records == model.stamped_records:
        text += f" with their trigger times (digitizer.max_records = {limit})"
        remedy = f"tracking.pulse_count of at most {limit} and more shots, dual-port memory, or a larger max_records: "
        remedy += f"the times of records above {model.stamped_records} then follow from counting"
    yield pass_or_refuse("memory", capture.record_count <= limit, text, remedy)
    if model.stamped_records < capture.record_count <= limit:
        text = f"single-port records above {model.stamped_records} have no trigger time and their times follow from "
        text += "counting: a missed trigger among them would shift all later records"
        remedy = f"tracking.pulse_count of at most {model.stamped_records}, or dual-port memory"
        yield CheckResult("trigger times", "warning", text, remedy)
