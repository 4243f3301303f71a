"""Commissioning of a bench: one cable after the other is driven, and looked for at the digitizer.

The master fires the tracking train, which triggers the digitizer. A T piece leads one place of the wiring at a time to
channel B: the beginning of every cable, then the end of every cable. The signal there shows which instrument drives it.
The delay of a cable is the difference of the times at its ends. Outputs are off while the T piece is moved.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import date
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, cast

import numpy as np

from drivers.interfaces import Capture, DeadlineError, Generator, InstrumentError, MasterTrigger, PulseGenerator
from hpe_rig.arrays import FloatArray
from hpe_rig.bench import Bench, BenchFile, BenchText, open_bench, parse_bench, silent_world
from hpe_rig.measurement.cable_signals import SAMPLE_RATE_HZ, Arrival, arrival, capture_of, command_pulse, tasks
from hpe_rig.scene import Mistake, SettingsError
from hpe_rig.store import replace_text

FIRES: Final = 32
"""Master triggers at each place of the T piece; u of a delay is a tenth to half of a sample period."""
DEADLINE_S: Final = 0.3
"""Time from a master trigger to the arrival of its record in this process."""
MAX_LEAD_U: Final = 4.0
"""Largest lead of a signal at the end of its cable, in standard uncertainties, that counts as rounding."""
TWIN_T_PIECE_S: Final = 5e-9
CHAIN: Final = ("master", "burst_train", "toneburst", "tracking_train", "digitizer", "tracking_pulser")


@dataclass(frozen=True, slots=True)
class Tap:
    """A place of the T piece: the output ``source``, or the end of its cable at the input ``target``."""

    source: str
    target: str | None = None

    def __str__(self) -> str:
        return f"{self.target}, where the cable from {self.source} ends" if self.target else self.source


@dataclass(frozen=True, slots=True)
class CableResult:
    """One cable: its delay with standard uncertainty u, NaN if it was not measured, and its fault in words."""

    source: str
    target: str
    delay_s: float = math.nan
    delay_u_s: float = math.nan
    fault: str = ""


Operator = Callable[[Bench, Tap | None], None]
"""Moves the T piece to a place, or removes it, and returns when that is done; outputs are off meanwhile."""


def taps(bench: BenchFile) -> list[Tap]:
    """Return the places of the T piece in order: all outputs, then the ends of all cables.

    Neighbours in this order have different signals, so that a T piece that was not moved is noticed.
    """
    ends = [Tap(cable.source, cable.target) for cable in bench.wiring]
    ends.sort(key=lambda tap: _place_in_chain(tap.source, tap.target or ""))
    outputs = sorted({cable.source for cable in bench.wiring}, key=lambda source: CHAIN.index(_role(source)))
    return [*map(Tap, outputs), *ends]


def _place_in_chain(source: str, target: str) -> tuple[int, bool]:
    """Return a sorting key of an input: a transducer follows the trigger of the generator that drives it."""
    is_drive = _role(target) not in CHAIN
    return CHAIN.index(_role(source if is_drive else target)), is_drive


def _role(end: str) -> str:
    return end.partition(".")[0]


def twin_operator(bench: BenchFile) -> Operator:
    """Return the operator of a simulated bench that is wired as its bench file states."""

    def move(instruments: Bench, tap: Tap | None) -> None:
        if instruments.world is not None:
            delay_s = bench.path_delay_s(tap.source, tap.target) if tap and tap.target else 0.0
            plug = [(tap.source, "digitizer.channel_b", TWIN_T_PIECE_S + delay_s)] if tap else []
            instruments.world.plug(plug)

    return move


def commission(
    bench: BenchFile, operator: Operator, rng: np.random.Generator, fires: int = FIRES, world: Any = None
) -> tuple[CableResult, ...]:
    """Return the result of every cable of ``bench``; all outputs are off, verified, when this returns.

    ``rng`` varies the phase of the sample clock at the triggers. ``world`` is the twin of a simulated bench, by default
    one that is wired as stated. Raises ``InstrumentError`` if an instrument or the trigger fails.
    """
    # Records begin before their trigger, which NPT mode does not allow.
    mode = None if bench.digitizer.acquisition_mode == "npt" else bench.digitizer.acquisition_mode
    bench = bench.model_copy(update={"digitizer": bench.digitizer.model_copy(update={"acquisition_mode": mode})})
    if bench.simulated and world is None:
        world = silent_world(bench)
    with open_bench(None, bench, (*bench.generators.by_role, "digitizer"), world=world) as instruments:
        signals: dict[Tap, Arrival | None] = {}
        if faults := _trigger_faults(instruments, bench):
            return _untested(bench, faults)
        _program(instruments, bench)
        for tap in taps(bench):
            operator(instruments, tap)
            signals[tap] = _signal(tap, instruments, bench, fires, rng)
        operator(instruments, None)
        # A plug that was left open with the T piece is noticed here.
        if faults := _trigger_faults(instruments, bench):
            return _untested(bench, faults)
    return tuple(_judged(cable.source, cable.target, signals) for cable in bench.wiring)


def _untested(bench: BenchFile, faults: Mapping[tuple[str, str], str]) -> tuple[CableResult, ...]:
    untested = "not tested: the digitizer gets no trigger"
    ends = ((cable.source, cable.target) for cable in bench.wiring)
    return tuple(CableResult(*pair, fault=faults.get(pair, untested)) for pair in ends)


def _program(instruments: Bench, bench: BenchFile) -> None:
    """Program one pulse or burst for each trigger; outputs stay off."""
    for role, task in tasks(bench).items():
        getattr(instruments, role).configure(task)


def _trigger_faults(instruments: Bench, bench: BenchFile) -> dict[tuple[str, str], str]:
    """Return by cable what prevents the master from triggering the digitizer; empty if it does."""
    _program(instruments, bench)
    capture = capture_of("tracking_train", bench, 1)
    if _triggers(instruments, capture, instruments.master, instruments.tracking_train):
        return {}
    to_train, to_digitizer = ("master.output", "tracking_train.trigger"), ("tracking_train.output", "digitizer.trigger")
    if _triggers_alone(instruments, capture, bench, "tracking_train"):
        fault = "no pulse of the master arrives. The cable is open, reversed or leads elsewhere, or two addresses are "
        return {to_train: f"{fault}exchanged. Try: both ends of the cable, generators.master.address"}
    # An inverted pulse crosses the negative level upwards when it ends.
    inverted = replace(capture, trigger_level_v=-capture.trigger_level_v)
    if _triggers_alone(instruments, inverted, bench, "tracking_train"):
        return {
            to_digitizer: "the pulses arrive inverted. The conductors of the cable are exchanged. Try: another cable"
        }
    for role in ("master", "burst_train"):
        if getattr(instruments, role) is not None and _triggers_alone(instruments, capture, bench, role):
            fault = f"the pulses of {role} arrive there. Two cables or two addresses are exchanged. "
            return {to_digitizer: f"{fault}Try: follow both cables, compare generators.{role}.address"}
    fault = "no pulse arrives. The cable is open or leads elsewhere, or two addresses are exchanged. "
    return {to_digitizer: f"{fault}Try: both ends of the cable, generators.tracking_train.address"}


def _triggers_alone(instruments: Bench, capture: Capture, bench: BenchFile, role: str) -> bool:
    """Return whether a pulse of ``role``, by command and with all other outputs off, triggers the digitizer."""
    # Every driver of a generator accepts every task.
    generator = cast(MasterTrigger, getattr(instruments, role))
    generator.configure(command_pulse(bench))
    return _triggers(instruments, capture, generator)


def _triggers(instruments: Bench, capture: Capture, source: MasterTrigger, train: PulseGenerator | None = None) -> bool:
    """Return whether a pulse of ``source``, if necessary through ``train``, triggers the digitizer."""
    return len(_records(instruments, capture, source, [] if train is None else [train])) > 0


def _records(
    instruments: Bench,
    capture: Capture,
    source: MasterTrigger,
    triggered: Sequence[Generator],
    rng: np.random.Generator | None = None,
) -> FloatArray:
    """Fire ``source`` once a record and return the records that came, in volts: (record, channel, sample).

    Every output is off, verified, at the end. ``rng`` varies the phase of the sample clock.
    """
    digitizer, clock, records = instruments.digitizer, instruments.clock, list[FloatArray]()
    digitizer.configure(capture)
    try:
        digitizer.arm()
        # Downstream first: no generator may trigger an output that is not ready.
        for generator in triggered:
            generator.enable_output()
        for _ in range(capture.record_count):
            # The twin's clock advances in whole microseconds, which always meet the same phase of the sample clock.
            clock.sleep(0.0 if rng is None else rng.uniform(0.0, 1 / SAMPLE_RATE_HZ))
            source.enable_output()
            source.fire()
        with suppress(DeadlineError):
            for block in digitizer.records(clock.now_s() + DEADLINE_S):
                channels = (block,) if block.monitor is None else (block, block.monitor)
                volts = [item.codes * item.volts_per_code + item.volts_offset for item in channels]
                records.extend(np.swapaxes(volts, 0, 1))
    finally:
        instruments.make_safe()
    return np.array(records)


def _signal(tap: Tap, instruments: Bench, bench: BenchFile, fires: int, rng: np.random.Generator) -> Arrival | None:
    """Return the signal at ``tap``; raise ``InstrumentError`` without triggers, and if it is at channel A."""
    capture = capture_of(_role(tap.source), bench, fires)
    # Every generator except the master, which is the first one.
    triggered = instruments.generators[:0:-1]
    records = _records(instruments, capture, instruments.master, triggered, rng)
    if len(records) < fires:
        what = f"{len(records)} of {fires} records came with the T piece at {tap}"
        remedy = "look at T piece and cables, digitizer.trigger_level_v of at most 1.5 V, begin again"
        raise InstrumentError("digitizer", what, "the T piece halves the voltage, or a plug is loose", remedy)
    channel_a_v, channel_b_v = np.swapaxes(records, 0, 1)
    at_a, signal = (arrival(volts, capture.input_range_v) for volts in (channel_a_v, channel_b_v))
    # Channel A may also have crosstalk of the bursts.
    if signal is None and at_a is not None and at_a.role == _role(tap.source):
        what = f"the signal at {tap} comes to channel A"
        raise InstrumentError("digitizer", what, "the T piece leads there", "lead it to channel B, begin again")
    return signal


def _judged(source: str, target: str, signals: Mapping[Tap, Arrival | None]) -> CableResult:
    """Return the result of one cable from the signals at both of its ends."""
    start, end = signals[Tap(source)], signals[Tap(source, target)]
    fault = _start_fault(source, start) or _end_fault(source, target, end)
    if fault or start is None or end is None:
        return CableResult(source, target, fault=fault)
    delay_s, u_s = end.time_s - start.time_s, math.hypot(start.u_s, end.u_s)
    if delay_s < -MAX_LEAD_U * u_s:
        fault = f"the signal arrives {-delay_s * 1e9:.1f} ns before it starts. The T piece was at the wrong end. "
        return CableResult(source, target, fault=f"{fault}Try: begin again")
    return CableResult(source, target, max(0.0, delay_s), u_s)


def _start_fault(source: str, signal: Arrival | None) -> str:
    role = _role(source)
    if signal is None:
        fault = f"no signal at {source}. {role} is not triggered, or another instrument answers at its address. "
        return f"{fault}Try: the faults before this one"
    if signal.role != role:
        fault = f"at {source} is the signal of {signal.role}. The T piece is at another output, or two addresses are "
        return f"{fault}exchanged. Try: compare generators.{role}.address and generators.{signal.role}.address"
    return f"the signal at {source} is inverted. Try: another cable from the T piece" if signal.inverted else ""


def _end_fault(source: str, target: str, signal: Arrival | None) -> str:
    if signal is None:
        return f"no signal at {target}. The cable is open or leads elsewhere. Try: both ends of the cable"
    if signal.role != _role(source):
        return f"the signal of {signal.role} arrives at {target}. Two cables are exchanged. Try: follow both"
    fault = f"the signal arrives inverted at {target}. The conductors of the cable are exchanged. Try: another cable"
    return fault if signal.inverted else ""


def with_commissioning(text: str, name: str, results: Sequence[CableResult], day: date) -> str:
    """Return the ``text`` of a bench file with the measured delays and the table [commissioning].

    Comments and order stay. If a cable has a fault, the text is returned without [commissioning].
    """
    import tomlkit

    document: Any = tomlkit.parse(text)
    document.pop("commissioning", None)
    if any(result.fault for result in results):
        return tomlkit.dumps(document)
    by_ends = {(result.source, result.target): result for result in results}
    for cable in document["wiring"]:
        result = by_ends[cable["source"], cable["target"]]
        # To 10 ps, a hundredth of the uncertainty.
        cable["delay_s"], cable["delay_u_s"] = round(result.delay_s, 11), round(result.delay_u_s, 11)
    bench = parse_bench(name, tomlkit.dumps(document)).bench
    table = tomlkit.table()
    table["date"], table["program"] = day, f"hpe-rig {version('hpe-rig')}"
    table["digest"] = bench.commissioned_digest
    table["cables"] = [f"{result.source} -> {result.target}" for result in results]
    document["commissioning"] = table
    return tomlkit.dumps(document)


def record_commissioning(path: Path, before: BenchText, results: Sequence[CableResult], day: date) -> None:
    """Write the results into the bench file ``path``, read as ``before``; other changes since then are kept.

    Raises ``SettingsError`` if its instruments or cables were changed during the commissioning.
    """
    # Line ends stay as they are, so the text is not read with universal newlines.
    text = path.read_bytes().decode("utf-8-sig")
    if parse_bench(path.stem, text).bench.commissioned_digest != before.bench.commissioned_digest:
        what = "its instruments or cables were changed during the commissioning, which is not recorded"
        raise SettingsError(f"bench {path.stem}", [Mistake("", what, "commission again")])
    replace_text(path, with_commissioning(text, path.stem, results, day))
