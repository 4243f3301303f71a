"""Checks of the digitizer: what its driver refuses, the gate in the record, memory."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from drivers.alazar import BoardModel, mistakes
from drivers.interfaces import Capture
from hpe_rig.bench import BenchFile, twin_of
from hpe_rig.plan.checks.check_result import CheckResult, Level, in_hz, judged
from hpe_rig.plan.selection import select
from hpe_rig.plan.shots import Plan, reference_gate
from hpe_rig.scene import Scene

LEAST_PERIODS = 2.0
SPARE_SAMPLES = 16
"""Samples at either end of a record that a following gate does not need to reach."""


def gate_in_record(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield whether gate and reference gate lie in the record, and the gate is not too short."""
    shot = plan.shots[0]
    gate, samples = shot.gate, shot.capture.record_samples
    text = f"the gate takes samples {gate.start} to {gate.stop} of a record of {samples}"
    model = bench.digitizer.board_model
    needed = gate.stop if gate.start >= 0 else gate.stop - gate.start + 2 * model.record_multiple
    longer = _allowed_record_samples(needed, model)
    remedy = f"acquisition.record_samples = {longer} or more, or a shorter acquisition.gate_length_m"
    yield judged("gate in record", gate.start >= 0 and gate.stop <= samples, text, remedy)
    still = reference_gate(scene, shot)
    if still is not None:
        text = f"the reference gate takes samples {still.start} to {still.stop} of a record of {samples}"
        remedy = "processing.reference_gate_depth_m closer to acquisition.gate_depth_m, "
        remedy += "or more acquisition.record_samples"
        yield judged("reference gate in record", still.start >= 0 and still.stop <= samples, text, remedy)
    length = gate.stop - gate.start
    text = f"the gate holds {length} samples"
    yield judged("gate samples", length >= 8, text, "a longer acquisition.gate_length_m or a higher sample rate")
    periods = length / shot.capture.sample_rate_hz * scene.tracking.carrier_hz
    if periods < LEAST_PERIODS:
        text = f"the gate holds {periods:.2g} periods of tracking.carrier_hz, and an echo has no phase in fewer than "
        remedy = "a longer acquisition.gate_length_m or a higher tracking.carrier_hz"
        yield CheckResult("gate periods", "refused", f"{text}{LEAST_PERIODS:g}", remedy)


def background(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield whether the gate, or the record in which it follows, holds the background motion that is declared."""
    shot, acquisition = plan.shots[0], scene.acquisition
    gate, samples, follows = shot.gate, shot.capture.record_samples, scene.processing.follow_gate
    per_metre = 2 / acquisition.sound_speed_m_per_s * shot.capture.sample_rate_hz
    room_m = min(gate.start, samples - gate.stop) / per_metre
    text = f"acquisition.record_samples = {samples} lets the gate follow by {room_m * 1e3:.3g} mm"
    twin = twin_of(scene) if bench.simulated else None
    moved_m = None if twin is None else twin.background_m(shot.timeline.sensing_s[select(scene, shot).window])
    if moved_m is None or not moved_m.size:
        if follows:
            yield CheckResult("gate follows", "passed", text)
        return
    farthest_m = float(np.abs(moved_m - moved_m[0]).max())
    moves = f"the background moves by {farthest_m * 1e3:.3g} mm in the processing window"
    if not follows:
        text = f"{moves}, the gate is {acquisition.gate_length_m * 1e3:.3g} mm long"
        good = farthest_m < acquisition.gate_length_m / 4
        level: Level = "passed" if good else "warning"
        yield CheckResult("background", level, text, "" if good else "processing.follow_gate = true")
        return
    longest = gate.stop - gate.start + 2 * math.ceil(farthest_m * per_metre) + 2 * SPARE_SAMPLES
    needed = _allowed_record_samples(longest, bench.digitizer.board_model)
    remedy = f"acquisition.record_samples = {needed}, or a shorter processing.window_length_s"
    yield judged("gate follows", farthest_m <= room_m, f"{text}, {moves}", remedy)
    text = f"the background stands {abs(moved_m[0]) * 1e3:.3g} mm off the focus at the first pulse"
    remedy = "another simulation.background phase_rad or processing.window_start_s: the gate begins at the focus"
    yield judged("gate at focus", abs(moved_m[0]) < acquisition.gate_length_m / 2, text, remedy)


def board(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield whether the board takes the records as they are asked for, and samples the carrier.

    The driver is asked: what it would refuse is refused here, in its words where no check has its own.
    """
    capture, model, carrier_hz = plan.shots[0].capture, bench.digitizer.board_model, scene.tracking.carrier_hz
    refused = mistakes(_plain(capture), model)
    checks = _record_checks(capture, model)
    for field, (check, text, remedy) in checks.items():
        yield judged(check, all(mistake.field != field for mistake in refused), text, remedy)
    for mistake in refused:
        if mistake.field not in checks:
            yield CheckResult("digitizer", "refused", mistake.text, f"{_KEYS[mistake.field]} within that")
    nyquist_hz = capture.sample_rate_hz / 2
    text = f"tracking.carrier_hz = {in_hz(carrier_hz)}, half the sampling rate is {in_hz(nyquist_hz)}"
    yield judged("carrier", carrier_hz < nyquist_hz, text, f"acquisition.sample_rate_hz above {in_hz(2 * carrier_hz)}")


_KEYS = {"record_count": "tracking.pulse_count", "trigger_level_v": "digitizer.trigger_level_v"}


def _record_checks(capture: Capture, model: BoardModel) -> dict[str, tuple[str, str, str]]:
    """Return name, text and remedy of the checks that a field of ``Capture`` has of its own."""
    rates = ", ".join(f"{rate / 1e6:g}" for rate in model.sample_rates_hz)
    ranges = ", ".join(f"{volts:g}" for volts in model.input_ranges_v)
    samples, multiples = capture.record_samples, f"multiples of {model.record_multiple} from {model.record_minimum}"
    delay, longest = capture.trigger_delay_samples, model.max_trigger_delay_samples
    return {
        "sample_rate_hz": (
            "sample rate",
            f"acquisition.sample_rate_hz = {in_hz(capture.sample_rate_hz)} on the {model.name}",
            f"one of {rates} MHz",
        ),
        "input_range_v": (
            "input range",
            f"acquisition.input_range_v = {capture.input_range_v:g} V on the {model.name}",
            f"one of {ranges} V",
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
    """Return the shortest record of at least ``samples`` that the board takes."""
    return max(model.record_minimum, model.record_multiple * math.ceil(samples / model.record_multiple))


def _plain(capture: Capture) -> Capture:
    return replace(capture, monitor_range_v=None)


def capture_mode(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield whether the board can capture in the bench file's mode, with its second channel where it is recorded."""
    board, capture = bench.digitizer, plan.shots[0].capture
    channels = "channel A" if capture.channels == 1 else "channels A and B"
    text = f"digitizer.acquisition_mode = {board.mode}, {channels}"
    if board.mode != "single_port" and not board.has_dual_port_memory:
        remedy = 'acquisition_mode = "single_port", or dual_port_memory = true where the board has it'
        yield CheckResult("capture mode", "refused", f"{text}: needs dual-port memory", remedy)
    # What the board cannot do of one channel in the plainest mode is said by the check above.
    plain = mistakes(_plain(capture), board.board_model)
    refused = [mistake for mistake in mistakes(capture, board.board_model, board.mode) if mistake not in plain]
    remedy = "another digitizer.acquisition_mode, monitor_range_v or acquisition.record_samples"
    for mistake in refused:
        yield CheckResult("capture mode", "refused", f"{text}: {mistake.text}", remedy)
    if not refused:
        yield CheckResult("capture mode", "passed", text)


def memory(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield whether the board's memory holds the records of a shot, where they cannot leave it before its end."""
    board, capture = bench.digitizer, plan.shots[0].capture
    if board.mode != "single_port":
        yield CheckResult("memory", "passed", f"{capture.record_count} records stream through dual-port memory")
        return
    held = min(board.max_records, board.board_model.most_records(board.samples_per_channel, capture.record_samples))
    text = f"{capture.record_count} records of {capture.record_samples} samples, the board holds {held}"
    remedy = f"tracking.pulse_count of at most {held}, or shorter acquisition.record_samples"
    stamped = board.board_model.stamped_records
    if held == board.max_records == stamped:
        text += f" with their trigger times (digitizer.max_records = {held})"
        remedy = f"tracking.pulse_count of at most {held} and more shots, dual-port memory, or a larger max_records: "
        remedy += f"records above {stamped} are then placed by counting"
    yield judged("memory", capture.record_count <= held, text, remedy)
    if stamped < capture.record_count <= held:
        text = f"single-port records above {stamped} have no trigger time and are placed by counting: a trigger lost "
        text += "among them would shift the records behind it"
        remedy = f"tracking.pulse_count of at most {stamped}, or dual-port memory"
        yield CheckResult("trigger times", "warning", text, remedy)
