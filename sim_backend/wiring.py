"""Wiring: clock, cables, voltage steps and bursts, with times in integer picoseconds."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from graphlib import CycleError, TopologicalSorter

import numpy as np

from sim_backend.arrays import FloatArray, IndexArray, Int64Array

PS_PER_S = 1_000_000_000_000

SOURCE_OHM = 50.0
"""Output impedance of every source (33250A: manual; AUX output: assumed)."""
DRIVE_INPUT_OHM = 50.0
"""Input impedance of the transducer's amplifier (assumed)."""
ECHO_LIFE_PS = 10_000_000_000
"""Echoes end this long after a pulse: 10 ms, 7.7 m of tissue and back."""


def to_ps(time_s: float) -> int:
    """Return ``time_s`` in whole picoseconds."""
    return round(time_s * PS_PER_S)


def elapsed_ps(interval_ps: Int64Array, clock_error: float) -> Int64Array:
    """Return the true duration of intervals that an instrument measures with its clock, to the nearest picosecond.

    ``clock_error`` is the relative error of the clock's rate, positive if it is fast.
    """
    if not clock_error:
        return interval_ps
    # The correction is small, so that its rounding as a float is far below 1 ps.
    return np.asarray(interval_ps - np.rint(interval_ps * (clock_error / (1 + clock_error))).astype(np.int64))


def measured_ps(interval_ps: Int64Array, clock_error: float) -> Int64Array:
    """Return how long true intervals last by an instrument's clock: the inverse of `elapsed_ps`."""
    return interval_ps + np.rint(interval_ps * clock_error).astype(np.int64) if clock_error else interval_ps


class SimulatedClock:
    """Time of the simulated bench in whole picoseconds; it advances by calls alone, and sleeping takes no real time."""

    def __init__(self) -> None:
        self.now_ps = 0

    def now_s(self) -> float:
        """Return the time since the start of the world."""
        return self.now_ps / PS_PER_S

    def sleep(self, duration_s: float) -> None:
        """Advance by ``duration_s``."""
        self.now_ps += max(0, to_ps(duration_s))

    def advance_to(self, time_ps: int) -> None:
        """Advance to ``time_ps``; a time in the past changes nothing."""
        self.now_ps = max(self.now_ps, time_ps)


@dataclass(frozen=True)
class Bursts:
    """Sine bursts; every array has shape (burst,)."""

    onset_ps: Int64Array
    end_ps: Int64Array
    carrier_hz: FloatArray
    cycles: FloatArray
    amplitude_vpp: FloatArray

    @functools.cached_property
    def longest_ps(self) -> int:
        """Duration of the longest burst; there must be at least one."""
        return int((self.end_ps - self.onset_ps).max())


BURST_FIELDS = ("onset_ps", "end_ps", "carrier_hz", "cycles", "amplitude_vpp")


@dataclass(frozen=True, slots=True)
class Capture:
    """Consecutive records of one arming, one an entry of ``first_sample_ps`` (record,).

    ``first_record`` is the number of records before them, ``origin_ps`` time zero of the capture. ``sample_period_ps``
    is nominal, by the digitizer's clock, which has the relative rate error ``clock_error``.
    """

    index: int
    origin_ps: int
    first_sample_ps: Int64Array
    sample_period_ps: int
    samples: int
    first_record: int = 0
    clock_error: float = 0.0


@dataclass(frozen=True, slots=True)
class Steps:
    """Steps of an output's open-circuit voltage, sorted by time; every array has shape (step,)."""

    time_ps: Int64Array
    before_v: FloatArray
    after_v: FloatArray


@dataclass(frozen=True, slots=True)
class Emission:
    """Output of an instrument; ``ignored`` counts the triggers that came while it was busy."""

    steps: Steps
    bursts: Bursts
    ignored: int = 0


@dataclass(frozen=True, slots=True)
class Cable:
    """A cable from an output ("master.output") to an input ("burst_train.trigger")."""

    source: str
    target: str
    delay_ps: int
    inverted: bool = False

    @property
    def source_role(self) -> str:
        """Role of the instrument that feeds the cable."""
        return _role(self.source)

    @property
    def sign(self) -> int:
        """Sign of the voltage at the end over that at the source."""
        return -1 if self.inverted else 1

    def carried(self, steps: Steps) -> Steps:
        """Return the voltage steps at the end of the cable."""
        return Steps(steps.time_ps + self.delay_ps, self.sign * steps.before_v, self.sign * steps.after_v)


Plug = tuple[str, str, float] | tuple[str, str, float, bool]
"""A cable as (source, target, delay in seconds), and whether its conductors are exchanged, which inverts its signal."""
Respond = Callable[[Steps], Emission]


def no_steps() -> Steps:
    """Return a constant voltage."""
    return Steps(np.empty(0, np.int64), np.empty(0), np.empty(0))


def no_bursts() -> Bursts:
    """Return an empty set of bursts."""
    return Bursts(np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0), np.empty(0), np.empty(0))


def joined_steps(trains: Iterable[Steps]) -> Steps:
    """Return the steps of all ``trains``, sorted by time; simultaneous steps keep their order."""
    trains = [train for train in trains if train.time_ps.size]
    if not trains:
        return no_steps()
    if len(trains) == 1 and bool(np.all(trains[0].time_ps[1:] >= trains[0].time_ps[:-1])):
        return trains[0]
    time_ps = np.concatenate([train.time_ps for train in trains])
    before_v, after_v = (np.concatenate([getattr(train, name) for train in trains]) for name in ("before_v", "after_v"))
    # A stable sort keeps the order of simultaneous steps.
    order = np.argsort(time_ps, kind="stable")
    return Steps(time_ps[order], before_v[order], after_v[order])


def joined_bursts(trains: Iterable[Bursts]) -> Bursts:
    """Return the bursts of all ``trains``, sorted by onset."""
    trains = [train for train in trains if train.onset_ps.size]
    if not trains:
        return no_bursts()
    order = np.argsort(np.concatenate([train.onset_ps for train in trains]), kind="stable")
    return Bursts(*(np.concatenate([getattr(train, name) for train in trains])[order] for name in BURST_FIELDS))


def near(bursts: Bursts, capture: Capture) -> Bursts:
    """Return at least the bursts that can contribute to ``capture``; bursts and records are sorted by time."""
    if not capture.first_sample_ps.size or not bursts.onset_ps.size:
        return bursts
    # Echoes of a burst may arrive for ECHO_LIFE_PS after its end.
    begin_ps = capture.first_sample_ps[0] - bursts.longest_ps - ECHO_LIFE_PS
    end_ps = capture.first_sample_ps[-1] + capture.samples * capture.sample_period_ps + ECHO_LIFE_PS
    contributing = slice(*bursts.onset_ps.searchsorted([begin_ps, end_ps]).tolist())
    return Bursts(*(getattr(bursts, name)[contributing] for name in BURST_FIELDS))


def crossings(steps: Steps, level_v: float, rising: bool, input_ohm: float) -> Int64Array:
    """Return when the voltage at an input of ``input_ohm`` crosses ``level_v``: int64 (edge,)."""
    # Voltage divider of source and input impedance.
    divider = input_ohm / (input_ohm + SOURCE_OHM)
    before, after = steps.before_v * divider, steps.after_v * divider
    is_edge = (before < level_v) & (after >= level_v) if rising else (before >= level_v) & (after < level_v)
    return steps.time_ps[is_edge]


def accepted(trigger_ps: Int64Array, busy_ps: int, limit: int | None = None) -> IndexArray:
    """Return the indices of the triggers that a busy instrument accepts, at most ``limit``.

    It is busy for ``busy_ps`` after each accepted trigger; a trigger at the end of that time is accepted.
    ``trigger_ps`` is sorted.
    """
    if np.all(np.diff(trigger_ps) >= busy_ps):
        return np.arange(trigger_ps.size)[:limit]
    # One search an accepted trigger: ignored ones are skipped together.
    indices: list[int] = []
    index = 0
    while index < trigger_ps.size and (limit is None or len(indices) < limit):
        indices.append(index)
        next_index = np.searchsorted(trigger_ps, trigger_ps[index] + busy_ps, side="left")
        index = max(index + 1, int(next_index))
    return np.array(indices, np.intp)


def cables_of(wiring: Sequence[Plug], sources: Sequence[str], targets: Sequence[str]) -> tuple[Cable, ...]:
    """Return the cables of ``wiring``, a list of (source, target, delay) or (source, target, delay, inverted).

    Raises ``ValueError`` for an unknown end or a negative delay.
    """
    for source, target, delay_s, *_ in wiring:
        if source not in sources:
            raise ValueError(f"wiring: no output {source!r}; the twin has {', '.join(sources)}")
        if target not in targets:
            raise ValueError(f"wiring: no input {target!r}; the twin has {', '.join(targets)}")
        if not delay_s >= 0:
            raise ValueError(
                f"wiring: {source} -> {target} has a delay of {delay_s} s; a cable cannot be faster than instantaneous"
            )
    # ``inverted`` is an empty list where it is not stated.
    return tuple(Cable(source, target, to_ps(delay_s), *inverted) for source, target, delay_s, *inverted in wiring)


def trigger_order(cables: Sequence[Cable], roles: Sequence[str]) -> tuple[str, ...]:
    """Return ``roles`` sorted so that each follows its trigger sources; raise ``ValueError`` for a loop."""
    # Topological sort of the graph of triggers.
    graph: dict[str, set[str]] = {role: set() for role in roles}
    for cable in cables:
        if cable.target.endswith(".trigger"):
            graph[_role(cable.target)].add(cable.source_role)
    try:
        return tuple(TopologicalSorter(graph).static_order())
    except CycleError as error:
        raise ValueError(
            f"wiring: a loop of triggers, {' -> '.join(error.args[1])}; remove one of its cables"
        ) from None


def propagate(
    cables: Sequence[Cable], respond: Mapping[str, Respond], inputs_of_50_ohm: Sequence[str] = ()
) -> dict[str, Emission]:
    """Return the signals that every instrument emits, evaluated along the cables from trigger source to target.

    ``respond`` (by role): emission of an instrument for voltage steps at its trigger input; an open input has none. An
    output of 50 ohm that also feeds one of ``inputs_of_50_ohm`` has half its voltage steps.
    """
    emissions: dict[str, Emission] = {}
    loaded = {cable.source_role for cable in cables if cable.target in inputs_of_50_ohm}
    for role in trigger_order(cables, tuple(respond)):
        arriving = [
            cable.carried(emissions[cable.source_role].steps) for cable in cables if cable.target == f"{role}.trigger"
        ]
        emissions[role] = respond[role](joined_steps(arriving))
        if role in loaded:
            steps = emissions[role].steps
            steps = replace(steps, before_v=steps.before_v / 2, after_v=steps.after_v / 2)
            emissions[role] = replace(emissions[role], steps=steps)
    return emissions


def bursts_at_amplifiers(
    cables: Sequence[Cable],
    emissions: Mapping[str, Emission],
    roles: Sequence[str],
    targets: Sequence[str] = ("transducer.drive",),
) -> Bursts:
    """Return the bursts that the generators of ``roles`` send to the amplifiers at ``targets``.

    Amplitudes are in volts, peak to peak, across the inputs of the amplifiers.
    """
    divider = DRIVE_INPUT_OHM / (DRIVE_INPUT_OHM + SOURCE_OHM)
    arriving = []
    for cable in cables:
        if cable.target in targets and cable.source_role in roles:
            bursts = emissions[cable.source_role].bursts
            onset_ps, end_ps = bursts.onset_ps + cable.delay_ps, bursts.end_ps + cable.delay_ps
            amplitude_vpp = bursts.amplitude_vpp * (cable.sign * divider)
            arriving.append(replace(bursts, onset_ps=onset_ps, end_ps=end_ps, amplitude_vpp=amplitude_vpp))
    return joined_bursts(arriving)


def _role(end: str) -> str:
    return end.partition(".")[0]
