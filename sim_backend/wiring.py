"""Wiring: the clock, and voltage steps, bursts and cables as arrays in integer picoseconds."""

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
HEARD_PS = 10_000_000_000
"""After this time nothing echoes any more: 10 ms, 7.7 m of tissue and back."""


def to_ps(time_s: float) -> int:
    """Return ``time_s`` in whole picoseconds."""
    return round(time_s * PS_PER_S)


class SimulatedClock:
    """Time of the simulated bench in whole picoseconds, moved only by what is done; sleeping takes no real time."""

    def __init__(self) -> None:
        self.now_ps = 0

    def now_s(self) -> float:
        """Return the time since the world began."""
        return self.now_ps / PS_PER_S

    def sleep(self, duration_s: float) -> None:
        """Move on by ``duration_s``."""
        self.now_ps += max(0, to_ps(duration_s))

    def advance_to(self, time_ps: int) -> None:
        """Move on to ``time_ps``; a time in the past changes nothing."""
        self.now_ps = max(self.now_ps, time_ps)


@dataclass(frozen=True)
class Bursts:
    """Sine bursts that reached the transducer; every array has shape (burst,)."""

    onset_ps: Int64Array
    end_ps: Int64Array
    carrier_hz: FloatArray
    cycles: FloatArray
    amplitude_vpp: FloatArray

    @functools.cached_property
    def longest_ps(self) -> int:
        """Duration of the longest burst; there is one."""
        return int((self.end_ps - self.onset_ps).max())


BURST_FIELDS = ("onset_ps", "end_ps", "carrier_hz", "cycles", "amplitude_vpp")


@dataclass(frozen=True, slots=True)
class Capture:
    """What the digitizer was triggered to record: one record an entry of ``first_sample_ps`` (record,).

    Of a long capture these may be some consecutive records alone, ``first_record`` the number of those before them.
    """

    index: int
    origin_ps: int
    first_sample_ps: Int64Array
    sample_period_ps: int
    samples: int
    first_record: int = 0


@dataclass(frozen=True, slots=True)
class Steps:
    """Steps of an output's open-circuit voltage, by time; every array has shape (step,)."""

    time_ps: Int64Array
    before_v: FloatArray
    after_v: FloatArray


@dataclass(frozen=True, slots=True)
class Emission:
    """What an instrument put out for what came in; ``ignored`` counts the triggers that it was too busy for."""

    steps: Steps
    bursts: Bursts
    ignored: int = 0


@dataclass(frozen=True, slots=True)
class Cable:
    """A cable from an output ("master.output") to an input ("burst_train.trigger")."""

    source: str
    target: str
    delay_ps: int


Respond = Callable[[Steps], Emission]


def no_steps() -> Steps:
    """Return a voltage that never changes."""
    return Steps(np.empty(0, np.int64), np.empty(0), np.empty(0))


def no_bursts() -> Bursts:
    """Return silence."""
    return Bursts(np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0), np.empty(0), np.empty(0))


def joined_steps(parts: Iterable[Steps]) -> Steps:
    """Return the steps of all ``parts`` by time; steps of one time keep their order."""
    parts = [part for part in parts if part.time_ps.size]
    if not parts:
        return no_steps()
    if len(parts) == 1 and bool(np.all(parts[0].time_ps[1:] >= parts[0].time_ps[:-1])):
        return parts[0]
    time_ps = np.concatenate([part.time_ps for part in parts])
    before_v, after_v = (np.concatenate([getattr(part, name) for part in parts]) for name in ("before_v", "after_v"))
    order = np.argsort(time_ps, kind="stable")
    return Steps(time_ps[order], before_v[order], after_v[order])


def joined_bursts(parts: Iterable[Bursts]) -> Bursts:
    """Return the bursts of all ``parts`` by onset."""
    parts = [part for part in parts if part.onset_ps.size]
    if not parts:
        return no_bursts()
    order = np.argsort(np.concatenate([part.onset_ps for part in parts]), kind="stable")
    return Bursts(*(np.concatenate([getattr(part, name) for part in parts])[order] for name in BURST_FIELDS))


def near(bursts: Bursts, capture: Capture) -> Bursts:
    """Return the bursts that a record of ``capture`` could hear, and some more; both by time."""
    if not capture.first_sample_ps.size or not bursts.onset_ps.size:
        return bursts
    begin_ps = capture.first_sample_ps[0] - bursts.longest_ps - HEARD_PS
    end_ps = capture.first_sample_ps[-1] + capture.samples * capture.sample_period_ps + HEARD_PS
    some = slice(*bursts.onset_ps.searchsorted([begin_ps, end_ps]).tolist())
    return Bursts(*(getattr(bursts, name)[some] for name in BURST_FIELDS))


def crossings(steps: Steps, level_v: float, rising: bool, input_ohm: float) -> Int64Array:
    """Return when an input of ``input_ohm`` sees the voltage pass ``level_v``: int64 (edge,)."""
    share = input_ohm / (input_ohm + SOURCE_OHM)
    before, after = steps.before_v * share, steps.after_v * share
    passed = (before < level_v) & (after >= level_v) if rising else (before >= level_v) & (after < level_v)
    return steps.time_ps[passed]


def accepted(trigger_ps: Int64Array, busy_ps: int, limit: int | None = None) -> IndexArray:
    """Return the indices of the triggers that find an instrument idle which is busy ``busy_ps`` after each.

    ``trigger_ps`` is sorted; a trigger exactly ``busy_ps`` after an accepted one is accepted too. At most ``limit``.
    """
    if np.all(np.diff(trigger_ps) >= busy_ps):
        return np.arange(trigger_ps.size)[:limit]
    # Duration is constant: one jump an accepted trigger, not a step a trigger.
    taken: list[int] = []
    index = 0
    while index < trigger_ps.size and (limit is None or len(taken) < limit):
        taken.append(index)
        idle_from = np.searchsorted(trigger_ps, trigger_ps[index] + busy_ps, side="left")
        index = max(index + 1, int(idle_from))
    return np.array(taken, np.intp)


def cables_of(
    wiring: Sequence[tuple[str, str, float]], sources: Sequence[str], targets: Sequence[str]
) -> tuple[Cable, ...]:
    """Return the cables of ``wiring``; raise ``ValueError`` for an end that does not exist or a delay below 0."""
    for source, target, delay_s in wiring:
        if source not in sources:
            raise ValueError(f"wiring: no output {source!r}; the twin has {', '.join(sources)}")
        if target not in targets:
            raise ValueError(f"wiring: no input {target!r}; the twin has {', '.join(targets)}")
        if not delay_s >= 0:
            raise ValueError(
                f"wiring: {source} -> {target} has a delay of {delay_s} s; a cable cannot answer before it is asked"
            )
    return tuple(Cable(source, target, to_ps(delay_s)) for source, target, delay_s in wiring)


def trigger_order(cables: Sequence[Cable], roles: Sequence[str]) -> tuple[str, ...]:
    """Return ``roles`` so that each comes after what triggers it; raise ``ValueError`` where the wiring has a loop."""
    graph: dict[str, set[str]] = {role: set() for role in roles}
    for cable in cables:
        if cable.target.endswith(".trigger"):
            graph[_role(cable.target)].add(_role(cable.source))
    try:
        return tuple(TopologicalSorter(graph).static_order())
    except CycleError as error:
        raise ValueError(
            f"wiring: a loop of triggers, {' -> '.join(error.args[1])}; remove one of its cables"
        ) from None


def propagate(cables: Sequence[Cable], respond: Mapping[str, Respond]) -> dict[str, Emission]:
    """Return what every role of ``respond`` puts out, evaluated along the wiring; an unwired input sees nothing."""
    emissions: dict[str, Emission] = {}
    for role in trigger_order(cables, tuple(respond)):
        arriving = [
            _delayed(emissions[_role(cable.source)].steps, cable.delay_ps)
            for cable in cables
            if cable.target == f"{role}.trigger"
        ]
        emissions[role] = respond[role](joined_steps(arriving))
    return emissions


def driven(
    cables: Sequence[Cable],
    emissions: Mapping[str, Emission],
    roles: Sequence[str],
    targets: Sequence[str] = ("transducer.drive",),
) -> Bursts:
    """Return the bursts of ``roles`` as they arrive at transducers, in volts across their amplifiers' inputs."""
    share = DRIVE_INPUT_OHM / (DRIVE_INPUT_OHM + SOURCE_OHM)
    arriving = []
    for cable in cables:
        if cable.target in targets and _role(cable.source) in roles:
            bursts = emissions[_role(cable.source)].bursts
            onset_ps, end_ps = bursts.onset_ps + cable.delay_ps, bursts.end_ps + cable.delay_ps
            arriving.append(
                replace(bursts, onset_ps=onset_ps, end_ps=end_ps, amplitude_vpp=bursts.amplitude_vpp * share)
            )
    return joined_bursts(arriving)


def _role(end: str) -> str:
    return end.partition(".")[0]


def _delayed(steps: Steps, delay_ps: int) -> Steps:
    return replace(steps, time_ps=steps.time_ps + delay_ps)
