"""Placement: which tracking pulse each record of a shot belongs to, from the digitizer's trigger times.

Records are stored in the order of arrival, with their trigger times as delivered. The placement is computed from these
when records are read, so that a faulty trigger time costs no record.

Trigger times are read from a counter in the digitizer, which can step (jump by an arbitrary time) or stand still.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from hpe_rig.arrays import BoolArray, FloatArray, Int64Array

TOLERANCE: Final = 0.05
"""Deviation of a trigger from the pulse train, in pulse periods, above which no pulse caused it. Trigger jitter is far
smaller; the clock error of the digitizer is removed before."""
MIN_SEGMENT: Final = 2
"""Minimum number of consecutive records, whole periods apart, that belong to the train although a step of the counter
separates them from the records before. A single such record comes from a stray trigger."""
MIN_WRAPS: Final = 3
"""Number of equal jumps back of the trigger times that identifies them as wraps of the counter."""
MAX_CLOSED_GAPS: Final = 20
"""Number of steps of the counter by whole periods that are recognised in one shot; records after more have no pulse."""


@dataclass(frozen=True, slots=True)
class Placement:
    """Tracking pulses of the records of one shot, with record k in row k of the file.

    Attributes:
        pulse: int64 (record,), the pulse of each record, -1 for none.
        delivered: (record,), True for the records that arrived; there are as many places as planned pulses.
        loose: (record,), True if the number of pulses since the record before is not measured but assumed to be 1.
        unlocated: number of missing pulses at the end of the train, or anywhere if there are no trigger times. Those at
            its start may be missing instead. After stray triggers a capture ends before the train.
        stray: numbers of the records of triggers between the pulses.
        remarks: faults of the trigger times, as sentences.
    """

    pulse: Int64Array
    delivered: BoolArray
    loose: BoolArray
    unlocated: int = 0
    stray: tuple[int, ...] = ()
    remarks: tuple[str, ...] = ()

    @property
    def is_identity(self) -> bool:
        """Whether every record has the number of its pulse."""
        return bool(np.array_equal(self.pulse, np.where(self.delivered, np.arange(self.pulse.size), -1)))

    @property
    def record(self) -> Int64Array:
        """The record of each pulse, int64 (pulse,), -1 for a missing one."""
        placed = np.flatnonzero(self.pulse >= 0)
        record = np.full(self.pulse.size, -1)
        record[self.pulse[placed]] = placed
        return record

    def shifted(self, shift: Int64Array) -> Placement:
        """Return the placement with the pulse of each record moved by ``shift`` (record,); outside the train: none."""
        pulse = np.where(self.pulse >= 0, self.pulse + shift, -1)
        return replace(self, pulse=np.where(pulse < self.pulse.size, pulse, -1))


def place_records(delivered: BoolArray, time_s: FloatArray, rate_hz: float) -> Placement:
    """Return the placement of the ``delivered`` records (record,), given their trigger times (record,), NaN if unknown.

    The first record on the pulse train is assigned to the first pulse. Records without trigger time are counted from
    the record before. Trigger times that step by no whole number of periods, or by more pulses than the train has, are
    a fault of the counter: later records are assigned to pulses by counting from there.
    """
    records, pulses = np.flatnonzero(delivered), delivered.size
    counted = Placement(np.where(delivered, np.arange(pulses), -1), delivered, delivered, pulses - records.size)
    timed = records[np.isfinite(time_s[records])]
    if not timed.size or not np.isfinite(rate_hz):
        return counted
    # Times from each trigger to the next, in pulse periods.
    step = np.diff(time_s[timed]) * rate_hz
    is_one_period = np.abs(step - 1) < TOLERANCE
    if timed.size == records.size and is_one_period.all():
        # Every record has a trigger time one period after the last: the pulses are consecutive.
        pulse = counted.pulse.copy()
        pulse[records] = np.arange(records.size)
        return replace(counted, pulse=pulse, loose=np.zeros(pulses, bool))
    # The clock of the digitizer may be wrong by up to one per cent, which adds up over long gaps.
    period_s = (float(np.median(step[is_one_period])) if is_one_period.any() else 1.0) / rate_hz
    # Records that repeat a trigger time are left out of the train, and counted from the record before.
    frozen = _repeated_times(step)
    train = _Train(timed[~frozen], time_s[timed[~frozen]] / period_s).within(pulses)
    placement = _placement(train, delivered)
    return replace(placement, remarks=(*_jump_remarks(train, period_s), *_freeze_remarks(timed[frozen])))


def _repeated_times(step: FloatArray) -> BoolArray:
    """Return which records repeat the trigger time of the record before, (record,), at least two in a row.

    ``step`` (record - 1,): time from each record to the next, in pulse periods.
    """
    repeats = np.concatenate([[False], np.abs(step) < TOLERANCE])
    previous_repeats = np.concatenate([[False], repeats[:-1]])
    next_repeats = np.concatenate([repeats[1:], [False]])
    return np.asarray(repeats & (previous_repeats | next_repeats))


def _placement(train: _Train, delivered: BoolArray) -> Placement:
    """Return the placement of the delivered records: those of the train, and those without usable trigger time."""
    # Segments of the train have measured numbers of pulses; the first record of each further segment does not.
    pulses, segments = delivered.size, train.segments()
    pulse, loose = np.full(pulses, -1), np.zeros(pulses, bool)
    placed = train.record[np.concatenate([segment.index for segment in segments])]
    pulse[placed] = np.concatenate([segment.pulse for segment in segments])
    loose[[train.record[segment.index[0]] for segment in segments[1:]]] = True
    stray = np.setdiff1d(train.record, placed)
    # Records without a usable trigger time are counted from the placed record before.
    untimed = np.setdiff1d(np.flatnonzero(delivered), train.record)
    before = np.maximum(np.searchsorted(placed, untimed) - 1, 0)
    pulse[untimed] = pulse[placed[before]] + untimed - placed[before]
    after = placed[np.minimum(before + 1, placed.size - 1)]
    # Records were lost between two trigger times: those without a time in between cannot be placed.
    unknown = (after > untimed) & (untimed > placed[before]) & (pulse[after] - pulse[untimed] != after - untimed)
    loose[untimed[after < untimed]] = True
    pulse[untimed[unknown]] = -1
    # The first record that has a pulse gets pulse 0.
    assigned = np.setdiff1d(np.concatenate([placed, untimed[~unknown]]), stray)
    pulse[assigned] -= pulse[assigned].min()
    pulse[pulse >= pulses] = -1
    unlocated = pulses - 1 - int(pulse.max())
    return Placement(pulse, delivered, loose, unlocated, tuple(stray.tolist()))


def _jump_remarks(train: _Train, period_s: float) -> Iterator[str]:
    """Yield a sentence for each jump of the trigger times, where the digitizer's counter stepped between two segments.

    Trigger times in ``train`` are in pulse periods of ``period_s``. The jump is the difference of the trigger times
    minus the periods between the pulses of the two records. Equal jumps back are one sentence: the counter wraps.
    """
    jumps = list[tuple[int, float]]()
    for before, after in pairwise(train.segments()):
        last, first = before.index[-1], after.index[0]
        jump_s = float(train.period[first] - train.period[last] - after.pulse[0] + before.pulse[-1]) * period_s
        jumps.append((int(train.record[first]) + 1, jump_s))
    sizes_s = [jump_s for _, jump_s in jumps]
    if len(jumps) >= MIN_WRAPS and max(sizes_s) < 0 and max(sizes_s) - min(sizes_s) < TOLERANCE * period_s:
        yield (
            f"the trigger times jump by {sizes_s[0]:.3g} s {len(jumps)} times, first at record {jumps[0][0]}, as their "
            "counter wraps"
        )
        return
    for record, jump_s in jumps:
        yield f"the trigger times jump by {jump_s:.3g} s at record {record}"


def _freeze_remarks(frozen: Int64Array) -> Iterator[str]:
    """Yield a sentence for each series of records with the same trigger time."""
    for series in np.split(frozen, np.flatnonzero(np.diff(frozen) > 1) + 1) if frozen.size else ():
        yield f"the trigger times stand still from record {series[0]} to {series[-1] + 1}"


@dataclass(frozen=True, slots=True)
class _Train:
    """Timed records in the order of arrival: their numbers and their trigger times, both (timed record,).

    ``period``: the trigger times in pulse periods. ``resets``: indices of the first records after a gap that is a step
    of the counter. ``stray``: indices of records that are stray although they are whole periods from others.
    """

    record: Int64Array
    period: FloatArray
    resets: frozenset[int] = frozenset()
    stray: frozenset[int] = frozenset()

    def within(self, pulses: int) -> _Train:
        """Return the train with its largest gaps closed until its span fits the planned ``pulses``.

        A gap that is too long is a fault: a stray record at an end of the train, or a step of the counter elsewhere.
        """
        train, segments = self, self.segments()
        for _ in range(MAX_CLOSED_GAPS):
            gap, number = max((segment.largest_gap, number) for number, segment in enumerate(segments))
            if gap <= 1 or segments[-1].pulse[-1] - segments[0].pulse[0] < pulses:
                break
            segment = segments[number]
            position = int(np.argmax(np.diff(segment.pulse)))
            first, last = int(segment.index[position]), int(segment.index[position + 1])
            if segment is segments[0] and position == 0:
                train = replace(train, stray=train.stray | {first})
            elif segment is segments[-1] and position == segment.pulse.size - 2:
                train = replace(train, stray=train.stray | {last})
            else:
                train = replace(train, resets=train.resets | {last})
            segments = train.segments()
        return train

    def segments(self) -> list[_Segment]:
        """Return the parts of the train between steps of the digitizer's counter; the first one's pulses start at 0.

        Records that fit into no segment come from stray triggers and are omitted.
        """
        runs = list(self._regular_runs())
        # Each segment as a list of the runs that it is joined from.
        segments = list[list[_Segment]]()
        # Without a regular series, the first record is assumed to be part of the train.
        irregular = all(stop - start < MIN_SEGMENT for start, stop in runs)
        for start, stop in runs:
            pulse = np.round(self.period[start:stop] - self.period[start]).astype(np.int64)
            piece = _Segment(np.arange(start, stop), pulse)
            previous = segments[-1][-1] if segments else None
            # Whole periods after the previous piece: joined to its segment. Otherwise a new segment, after the fewest
            # pulses possible.
            periods = None if previous is None else self._periods_after(previous, start)
            if previous is not None and periods is not None:
                segments[-1].append(replace(piece, pulse=previous.pulse[-1] + periods + pulse))
            elif stop - start >= MIN_SEGMENT or (irregular and previous is None) or self._precedes_reset(start):
                advance = 0 if previous is None else previous.pulse[-1] + self._min_periods(previous, start)
                segments.append([replace(piece, pulse=pulse + advance)])
        return [_joined(segment_pieces) for segment_pieces in segments]

    def _precedes_reset(self, start: int) -> bool:
        """Return whether ``start`` is the first record and the next one has an earlier trigger time."""
        return start == 0 and bool(self.period[1] < self.period[0])

    def _min_periods(self, segment: _Segment, start: int) -> int:
        """Return the least number of periods from ``segment`` to ``start``: one more than the untimed records."""
        last = segment.index[-1]
        return int(self.record[start] - self.record[last] - (start - last) + 1)

    def _periods_after(self, segment: _Segment, start: int) -> int | None:
        """Return the periods from the end of ``segment`` to ``start``; None if they are not whole, or too few."""
        if start in self.resets:
            return None
        periods = float(self.period[start] - self.period[segment.index[-1]])
        rounded = round(periods)
        fits = rounded >= self._min_periods(segment, start) and abs(periods - rounded) < TOLERANCE
        return rounded if fits else None

    def _regular_runs(self) -> Iterator[tuple[int, int]]:
        """Yield start and end of every run of consecutive records that are whole pulse periods apart.

        Runs also end at resets and at stray records, which belong to no run.
        """
        # A time between two records is a break if it is no whole number of periods, or too short for the records
        # without trigger time in between, which take one period each.
        step = np.diff(self.period)
        untimed = np.diff(self.record) - 1
        periods = np.round(step)
        breaks = np.flatnonzero((periods < untimed + 1) | (np.abs(step - periods) >= TOLERANCE)) + 1
        cuts = {*breaks.tolist(), *self.resets, *(cut for stray in self.stray for cut in (stray, stray + 1))}
        for start, stop in pairwise(sorted({0, self.record.size, *cuts})):
            if start not in self.stray:
                yield start, stop


@dataclass(frozen=True, slots=True)
class _Segment:
    """Consecutive part of a train, without a step of the digitizer's counter between its records.

    ``index`` (record,): indices of the records in the train. ``pulse`` (record,): the pulse of each.
    """

    index: Int64Array
    pulse: Int64Array

    @property
    def largest_gap(self) -> int:
        """The largest number of pulses from one record to the next, 0 for a single record."""
        return int(np.diff(self.pulse).max(initial=0))


def _joined(parts: Sequence[_Segment]) -> _Segment:
    """Return consecutive parts of a segment as one."""
    return _Segment(np.concatenate([part.index for part in parts]), np.concatenate([part.pulse for part in parts]))
