"""What a plan asks of the digitizer against what the board can do."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

from drivers.alazar import capture_mistakes
from hpe_rig.bench import BOARD_MODELS, BenchFile
from hpe_rig.plan.checks.check_result import Finding, judged
from hpe_rig.plan.shots import Plan


def capture_mode(bench: BenchFile, plan: Plan) -> Iterator[Finding]:
    """Yield whether the board can capture in the bench file's mode, with its second channel where it is recorded."""
    board, capture = bench.digitizer, plan.shots[0].capture
    channels = "channel A" if capture.channels == 1 else "channels A and B"
    text = f"digitizer.acquisition_mode = {board.mode}, {channels}"
    if board.mode != "single_port" and not board.dual_port_memory:
        remedy = 'acquisition_mode = "single_port", or dual_port_memory = true where the board has it'
        yield Finding("capture mode", "refused", f"{text}: needs dual-port memory", remedy)
    # What one channel in the plainest mode cannot do either is told by the other checks.
    plain = set(capture_mistakes(replace(capture, monitor_range_v=None)))
    mistakes = [mistake for mistake in capture_mistakes(capture, board.mode) if mistake not in plain]
    remedy = "another digitizer.acquisition_mode, monitor_range_v or acquisition.record_samples"
    for mistake in mistakes:
        yield Finding("capture mode", "refused", f"{text}: {mistake}", remedy)
    if not mistakes:
        yield Finding("capture mode", "passed", text)


def board(bench: BenchFile, plan: Plan, carrier_hz: float) -> Iterator[Finding]:
    """Yield whether the board takes the records as they are asked for, and samples the carrier."""
    board, model, capture = bench.digitizer, BOARD_MODELS[bench.digitizer.model], plan.shots[0].capture
    rates = ", ".join(f"{rate / 1e6:g}" for rate in model.sample_rates_hz)
    text = f"acquisition.sample_rate_hz = {capture.sample_rate_hz:g} Hz on the {board.model}"
    yield judged("sample rate", capture.sample_rate_hz in model.sample_rates_hz, text, f"one of {rates} MHz")
    ranges = ", ".join(f"{volts:g}" for volts in model.input_ranges_v)
    text = f"acquisition.input_range_v = {capture.input_range_v:g} V on the {board.model}"
    yield judged("input range", capture.input_range_v in model.input_ranges_v, text, f"one of {ranges} V")
    good = capture.record_samples >= model.record_minimum and capture.record_samples % model.record_multiple == 0
    nearest = max(
        model.record_minimum, model.record_multiple * math.ceil(capture.record_samples / model.record_multiple)
    )
    text = f"acquisition.record_samples = {capture.record_samples}, the {board.model} takes multiples of "
    text += f"{model.record_multiple} from {model.record_minimum}"
    yield judged("record length", good, text, f"acquisition.record_samples = {nearest}")
    text = (
        f"trigger delay of {capture.trigger_delay_samples} samples, the board holds {model.max_trigger_delay_samples}"
    )
    good = capture.trigger_delay_samples <= model.max_trigger_delay_samples
    yield judged("trigger delay", good, text, "a gate nearer to the transducer")
    nyquist_hz = capture.sample_rate_hz / 2
    text = f"tracking.carrier_hz = {carrier_hz:g} Hz, half the sampling rate is {nyquist_hz:g} Hz"
    yield judged("carrier", carrier_hz < nyquist_hz, text, f"acquisition.sample_rate_hz above {2 * carrier_hz:g} Hz")


def memory(bench: BenchFile, plan: Plan) -> Iterator[Finding]:
    """Yield whether the board's memory holds the records of a shot, where they cannot leave it before its end."""
    board, capture = bench.digitizer, plan.shots[0].capture
    if board.mode != "single_port":
        yield Finding("memory", "passed", f"{capture.record_count} records stream through dual-port memory")
        return
    held = min(board.max_records, board.samples_per_channel // (capture.record_samples + 16))
    text = f"{capture.record_count} records of {capture.record_samples} samples, the board holds {held}"
    remedy = f"tracking.pulse_count of at most {held}, or shorter acquisition.record_samples"
    yield judged("memory", capture.record_count <= held, text, remedy)
