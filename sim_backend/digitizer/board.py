"""Board without its library: settings and the voltage at its trigger input -> records and AUX edges.

Assumed, no source found:
- the external trigger input has a high impedance;
- the board accepts the next trigger once a record, and the pre-trigger part of the next one, is complete;
- the AUX trigger output is 5 V behind 50 ohm. It rises at the sample clock's first tick after the trigger (by default
  regardless of the trigger delay) and falls at the end of the record.
Not modelled: triggers from an input channel or two engines at once, time-outs, AC coupling, bandwidth limit, other AUX
outputs.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, field, replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from sim_backend.arrays import BoolArray, FloatArray, Int64Array
from sim_backend.digitizer import codes
from sim_backend.digitizer.boards import BOARDS, IMPEDANCE_50_OHM, BoardType
from sim_backend.settings import TriggerFaults
from sim_backend.wiring import (
    PS_PER_S,
    Emission,
    Steps,
    accepted,
    crossings,
    elapsed_ps,
    joined_steps,
    measured_ps,
    no_bursts,
    to_ps,
)

TRIGGER_INPUT_OHM = 1e6
AUX_HIGH_V = 5.0
NO_FAULTS = TriggerFaults()
_LOG = logging.getLogger("sim_backend")
_SAMPLES_AT_ONCE = 1 << 15


@dataclass(frozen=True, slots=True)
class Input:
    """One input channel."""

    range_v: float = 0.8
    impedance: int = IMPEDANCE_50_OHM


@dataclass(frozen=True, slots=True)
class Engine:
    """One trigger engine: source, slope and level code."""

    source: int = codes.SOURCE_DISABLE
    slope: int = codes.SLOPE_POSITIVE
    level_code: int = 128


@dataclass(frozen=True, slots=True)
class BoardSettings:
    """All programmable settings of the board."""

    board: BoardType = BOARDS["ATS460"]
    sample_rate_hz: int = 100_000_000
    inputs: tuple[Input, ...] = (Input(),) * 4
    operation: int = 0
    engines: tuple[Engine, Engine] = (Engine(), Engine())
    external_range_v: float = 5.0
    delay_samples: int = 0
    aux_mode: int = codes.AUX_OUT_TRIGGER
    pre_samples: int = 0
    post_samples: int = 0
    record_count: int = 1
    signed: bool = False

    @property
    def sample_period_ps(self) -> int:
        """Period of the samples in a record, in whole picoseconds."""
        return round(PS_PER_S / self.sample_rate_hz)

    @property
    def clock_period_ps(self) -> Fraction:
        """Exact period of the sample clock: triggers and time stamps have no rounding that adds up."""
        return Fraction(PS_PER_S) / Fraction(self.sample_rate_hz)

    def next_ticks_ps(self, time_ps: Int64Array) -> Int64Array:
        """Return the first tick of the sample clock at or after each time, in whole picoseconds."""
        period_ps = self.clock_period_ps
        if period_ps.denominator == 1:
            whole_ps = int(period_ps)
            return np.asarray(-(-time_ps // whole_ps) * whole_ps)
        return np.rint(np.ceil(time_ps / float(period_ps)) * float(period_ps)).astype(np.int64)

    @property
    def record_samples(self) -> int:
        """Samples of a record."""
        return self.pre_samples + self.post_samples


@dataclass(frozen=True, slots=True)
class Arming:
    """One capture: armed at ``start_ps`` with ``settings``, ended at ``stop_ps``; ``forced_ps``: software triggers.

    ``clock_error`` is the relative error of the board's clock rate. A clock with an error starts at zero with the
    capture, so that equal captures have equal ticks at any time of the world.
    """

    index: int
    start_ps: int
    settings: BoardSettings
    stop_ps: int = 1 << 61
    forced_ps: tuple[int, ...] = ()
    clock_error: float = 0.0

    def by_clock(self, time_ps: Int64Array) -> Int64Array:
        """Convert true times to times by the board's clock."""
        return measured_ps(time_ps - self.start_ps, self.clock_error) if self.clock_error else time_ps

    def true_ps(self, clock_ps: Int64Array) -> Int64Array:
        """Convert times by the board's clock to true times."""
        return self.start_ps + elapsed_ps(clock_ps, self.clock_error) if self.clock_error else clock_ps

    def elapsed_ps(self, interval_ps: int) -> int:
        """Return the true duration of an interval of the board's clock."""
        return int(elapsed_ps(np.array(interval_ps), self.clock_error))


@dataclass(frozen=True, slots=True)
class AcceptedTriggers:
    """Triggers that an arming accepted, one record each; arrays (record,).

    ``tick_ps`` is the clock tick of the trigger, ``clock_ps`` the same by the board's own clock, ``is_forced``
    whether it came by command; ``ignored`` counts triggers during a record.
    """

    tick_ps: Int64Array
    first_sample_ps: Int64Array
    end_ps: Int64Array
    is_forced: BoolArray
    ignored: int
    clock_ps: Int64Array

    def complete(self, time_ps: int) -> int:
        """Return how many records are complete at ``time_ps``."""
        return int(np.searchsorted(self.end_ps, time_ps, side="right"))


@dataclass(frozen=True, slots=True)
class Latencies:
    """Delays from the trigger's clock tick to sample 0 and to the AUX edge, which may include the trigger delay."""

    sample_ps: int
    aux_ps: int
    aux_waits_for_delay: bool = False


def accepted_triggers(
    arming: Arming, arriving: Steps, latencies: Latencies, faults: TriggerFaults = NO_FAULTS
) -> AcceptedTriggers:
    """Return the triggers that the board accepts while it is armed, and the times of their records.

    ``arriving``: voltage steps at the trigger input. The board ignores triggers while it records.
    """
    settings, period_ps = arming.settings, arming.settings.sample_period_ps
    # All times are those of the board's clock, up to the accepted triggers.
    edge_ps = arming.by_clock(_trigger_edges(settings, arriving))
    forced_ps = arming.by_clock(np.array(arming.forced_ps, np.int64))
    start_ps, stop_ps = arming.by_clock(np.array([arming.start_ps, arming.stop_ps])).tolist()
    # Edges count while the board is armed and has its pre-trigger samples.
    ready_ps = start_ps + settings.pre_samples * period_ps
    edge_ps = _with_faults(edge_ps[edge_ps >= ready_ps], faults)
    edge_ps = np.sort(np.concatenate([edge_ps[(edge_ps >= ready_ps) & (edge_ps < stop_ps)], forced_ps]))
    # The sample clock registers an edge at its next tick.
    tick_ps = settings.next_ticks_ps(edge_ps)
    to_end_ps = latencies.sample_ps + (settings.delay_samples + settings.post_samples) * period_ps
    busy_ps = to_end_ps + settings.pre_samples * period_ps
    accepted_ps = tick_ps[accepted(tick_ps, busy_ps, settings.record_count)]
    is_forced = np.isin(accepted_ps, settings.next_ticks_ps(forced_ps))
    # Triggers after the last record are not counted as ignored.
    is_full = accepted_ps.size == settings.record_count
    during_ps = tick_ps[tick_ps < accepted_ps[-1] + to_end_ps] if is_full else tick_ps
    ignored = during_ps.size - accepted_ps.size
    if ignored:
        _LOG.info("digitizer: %d of %d triggers came while it was busy, and are ignored", ignored, during_ps.size)
    true_ps = arming.true_ps(accepted_ps)
    # Sample 0 and the end follow every trigger by equal intervals, so that rounding shifts no record against its pulse.
    to_first_ps = latencies.sample_ps + (settings.delay_samples - settings.pre_samples) * period_ps
    first_ps, end_ps = (true_ps + arming.elapsed_ps(interval_ps) for interval_ps in (to_first_ps, to_end_ps))
    return AcceptedTriggers(
        tick_ps=true_ps,
        first_sample_ps=first_ps,
        end_ps=end_ps,
        is_forced=is_forced,
        ignored=ignored,
        clock_ps=accepted_ps,
    )


def aux_steps(arming: Arming, triggers: AcceptedTriggers, latencies: Latencies) -> Steps:
    """Return the voltage steps of the AUX output: a pulse for each accepted trigger, if AUX is a trigger output."""
    if arming.settings.aux_mode != codes.AUX_OUT_TRIGGER:
        return joined_steps([])
    low, high = np.zeros(triggers.tick_ps.size), np.full(triggers.tick_ps.size, AUX_HIGH_V)
    settings = arming.settings
    delay_ps = settings.delay_samples * settings.sample_period_ps if latencies.aux_waits_for_delay else 0
    rise_ps = triggers.tick_ps + latencies.aux_ps + arming.elapsed_ps(delay_ps)
    fall_ps = np.maximum(triggers.end_ps, rise_ps)
    return joined_steps([Steps(rise_ps, low, high), Steps(fall_ps, high, low)])


def words(volts: FloatArray, channel: Input, settings: BoardSettings) -> NDArray[np.unsignedinteger]:
    """Return the digitizer codes of ``volts``, in their shape, left-justified in bytes or in little-endian words."""
    board = settings.board
    out = np.empty(volts.shape, f"<u{board.bytes_per_sample}")
    # 0 V lies between two codes: code = half scale + volts in steps, rounded.
    half_scale, highest = (2**board.bits - 1) / 2, 2**board.bits - 1
    flat_v, flat = volts.reshape(-1), out.reshape(-1)
    levels_per_v = half_scale / (channel.range_v / _input_gain(channel))
    # In pieces small enough for the processor's cache.
    levels = np.empty(min(flat.size, _SAMPLES_AT_ONCE))
    for first in range(0, flat.size, _SAMPLES_AT_ONCE):
        piece_v = flat_v[first : first + _SAMPLES_AT_ONCE]
        level = np.multiply(piece_v, levels_per_v, out=levels[: piece_v.size])
        level += half_scale
        np.rint(level, out=level)
        # Finding the extremes takes half the time of clipping.
        if level.min() < 0 or level.max() > highest:
            np.clip(level, 0, highest, out=level)
        flat[first : first + _SAMPLES_AT_ONCE] = level
    if settings.signed:
        # Two's complement with the board's number of bits.
        out -= out.dtype.type(1 << (board.bits - 1))
        out &= out.dtype.type(highest)
    out <<= out.dtype.type(8 * board.bytes_per_sample - board.bits)
    return out


def is_clipped(volts: float, channel: Input) -> bool:
    """Return whether a voltage exceeds the input range."""
    return abs(volts) * _input_gain(channel) > channel.range_v


def _input_gain(channel: Input) -> float:
    # Volts are those of a 50 ohm source into 50 ohm; into 1 Mohm they double.
    return 1.0 if channel.impedance == IMPEDANCE_50_OHM else 2.0


def _trigger_edges(settings: BoardSettings, arriving: Steps) -> Int64Array:
    """Return the ascending times (ps) when a trigger engine in use fires on the external input.

    The board has two engines, J and K, each a comparator with its own level and slope. ``arriving``: voltage steps at
    the input.
    """
    # Operation 0 uses engine J, 1 engine K, 2 either.
    engine_indices = {0: (0,), 1: (1,), 2: (0, 1)}.get(settings.operation, ())
    edges = [np.empty(0, np.int64)]
    for engine in (settings.engines[index] for index in engine_indices):
        if engine.source == codes.SOURCE_EXTERNAL:
            level_v = (engine.level_code - 128) / 127 * settings.external_range_v
            edges.append(crossings(arriving, level_v, engine.slope == codes.SLOPE_POSITIVE, TRIGGER_INPUT_OHM))
    sorted_ps = np.sort(np.concatenate(edges), kind="stable")
    # np.unique takes a hundred times as long for multiples of one period.
    return sorted_ps[np.diff(sorted_ps, prepend=sorted_ps[:1] - 1) > 0]


def _with_faults(edge_ps: Int64Array, faults: TriggerFaults) -> Int64Array:
    """Return ascending trigger edges without the lost ones and with the stray ones."""
    if not edge_ps.size:
        return edge_ps
    stray_ps = edge_ps[0] + np.array([to_ps(time_s) for time_s in faults.stray_s], np.int64)
    lost = [index for index in faults.lost if index < edge_ps.size]
    return np.sort(np.concatenate([np.delete(edge_ps, lost), stray_ps]))


@dataclass(slots=True)
class Board:
    """State of the board: present settings, and the armings since the world last forgot its past."""

    latencies: Latencies
    type: BoardType = BOARDS["ATS460"]
    settings: BoardSettings = field(default_factory=BoardSettings)
    armings: list[Arming] = field(default_factory=list)
    running: bool = False
    count: int = 0
    changes: int = 0
    faults: TriggerFaults = NO_FAULTS
    clock_error: float = 0.0
    serial_number: int | None = None

    def arm(self, now_ps: int, settings: BoardSettings) -> None:
        """Start a capture with ``settings``."""
        self.armings.append(Arming(self.count, now_ps, settings, clock_error=self.clock_error))
        self.count += 1
        self.running = True
        self.changes += 1

    def stop(self, now_ps: int) -> None:
        """End the running capture."""
        if self.running:
            self.armings[-1] = replace(self.armings[-1], stop_ps=now_ps)
            self.running = False
            self.changes += 1

    def force_trigger(self, now_ps: int) -> None:
        """Trigger the running capture by software."""
        if self.running:
            arming = self.armings[-1]
            self.armings[-1] = replace(arming, forced_ps=(*arming.forced_ps, now_ps))
            self.changes += 1

    def respond(self, arriving: Steps) -> tuple[Emission, list[AcceptedTriggers]]:
        """Return the board's AUX output, and the triggers accepted in each arming.

        ``arriving``: voltage steps at its trigger input.
        """
        triggers = [accepted_triggers(arming, arriving, self.latencies, self.faults) for arming in self.armings]
        pairs = zip(self.armings, triggers, strict=True)
        steps = [aux_steps(arming, accepted, self.latencies) for arming, accepted in pairs]
        ignored = sum(accepted.ignored for accepted in triggers)
        return Emission(joined_steps(steps), no_bursts(), ignored), triggers
