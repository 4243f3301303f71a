"""Acoustics of the twin, from the generators' outputs to the digitizer's input: bursts in, volts out.

    tonebursts -> force -> displacement at the focus -> scatterers -> echoes -> front end

A part the settings leave out is neither imported nor drawn nor summed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from sim_backend.arrays import ComplexArray, FloatArray, Int64Array
from sim_backend.echoes import (
    EchoDelays,
    Pulse,
    ScattererField,
    attenuated_to_focus,
    coloured,
    depth_delay_s,
    distinct_echoes,
    draw_field,
    echo_pulse,
    echoes,
    gaussian_weight,
    noticeable,
    rectangular_burst,
)
from sim_backend.receiver import (
    Begun,
    RecordNoise,
    RecordStream,
    echo_gain_v,
    leak_per_vpp_v,
    leak_v,
    pulse_strength,
    toneburst_echo_strength,
)
from sim_backend.settings import SimulationSettings
from sim_backend.wiring import PS_PER_S, Bursts, Capture, near, to_ps

if TYPE_CHECKING:
    from sim_backend.motion import MediumMotion

FocusMotion = Callable[[Bursts, Int64Array, int], FloatArray]

# Children of the world's seed: what each is used for must never change, or old scenes give new data.
_SCATTERER_STREAM = 0
_NOISE_STREAM = 1

# Relative; a thousandth of a 14-bit code of a full-scale echo is 1e-7, its phase error a pm of motion.
_ECHO_TOLERANCE = 1e-8
# Pulses that start up to some ns apart move the ends of their support: below this only the exact sum of each helps.
_FIELD_ECHO_TOLERANCE = 2e-7
_RECORDS_AT_ONCE = 64
_MOST_REPEATED = 256
"""Echoes that are kept for the next records: a periodic motion that is tracked at so many places of its period."""
_MOST_PULSES = 8
"""Kinds of pulse of which echoes are kept: a sweep of carriers or of burst lengths makes new ones in every shot."""


@dataclass(frozen=True, slots=True)
class Heard:
    """A pulse and what a beam lets it hear of the scatterers."""

    shape: Pulse
    weight: FloatArray
    """(scatterer,)"""
    colour: ComplexArray | None = None
    """(frequency, scatterer), what is heard of every frequency besides; None: all alike."""
    sensed: FloatArray | None = None
    """(scatterer,) delay that a displacement makes, over 2 u / c; None: 1."""


@dataclass(frozen=True, slots=True)
class Passage:
    """Bursts on their way through the focus; every array (burst,)."""

    onset_ps: Int64Array
    time_ps: Int64Array
    """When they pass the focus."""
    delay_s: FloatArray | None
    """By how much the background delays their echoes; None without background."""


class Acoustics:
    """The specimen, its scatterers and the receive chain of one world; the scatterers stay for all captures.

    The tracking transducer stands ``beside_m`` off the push along x, besides what ``settings.beams`` say of its axis.
    """

    def __init__(self, settings: SimulationSettings, beside_m: float = 0.0) -> None:
        x, y = settings.beams.lateral_offset_m
        beams = settings.beams.model_copy(update={"lateral_offset_m": (x + beside_m, y)})
        self._settings = settings = settings.model_copy(update={"beams": beams})
        self._beside_m = beside_m
        # From the transducer that tracks to the focus, and how much longer from the one that pushes.
        self._travel_s = settings.beams.tracked_from_m / settings.sound_speed_m_per_s
        self._push_later_s = settings.beams.focus_depth_m / settings.sound_speed_m_per_s - self._travel_s
        push_travel_s = self._travel_s + self._push_later_s
        placing = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(_SCATTERER_STREAM,)))
        # What attenuates around the focus is the specimen where it says how deep it is.
        loss = {"attenuation_db_per_cm_mhz": settings.echo_attenuation_db_per_cm_mhz}
        scatterers = settings.scatterers.model_copy(update=loss)
        self._field = draw_field(scatterers, settings.beams, placing, beside_m, self._placing)
        self._noise = RecordNoise(settings.receiver, RecordStream(settings.seed, _NOISE_STREAM))
        self._delay_s = depth_delay_s(self._field, settings.scatterers.axial_delay, settings.sound_speed_m_per_s)
        self._heard: dict[Pulse, Heard] = {}
        # By pulse the echoes of the latest records, where they were few: what decided them, and what came of it.
        self._repeated: dict[Pulse, tuple[tuple[FloatArray, FloatArray, Int64Array], FloatArray]] = {}
        reference = self._hear(
            echo_pulse(settings, settings.receiver.reference_carrier_hz), self._field.tracking_weight
        )
        self._gain_v = echo_gain_v(settings, self._delay_s, reference.weight, reference.colour)
        self._focus_motion = _focus_motion(settings, push_travel_s)
        self._medium = _medium_motion(settings, self._field, push_travel_s, beside_m)
        self._background_m = _background_motion(settings)

    def focus_displacement_m(
        self, tonebursts: Bursts, time_ps: Int64Array, origin_ps: int, *, index: int = 0
    ) -> FloatArray:
        """Return the displacement at the focus at ``time_ps`` (time,), positive away from the transducer, m.

        Where the tracking transducer was moved beside the push, that on its axis. ``tonebursts`` move a specimen;
        ``origin_ps`` is the master trigger's edge, from which a prescribed motion counts. Neither specimen nor motion:
        zeros.
        """
        if self._focus_motion is None:
            return np.zeros(len(time_ps))
        if self._beside_m and self._medium is not None:
            return self._medium.displacement_m(tonebursts, time_ps, self._beside_m)
        beside = np.array([[self._beside_m, 0.0, 0.0]])
        share = float(gaussian_weight(beside, self._settings.beams.motion_width_m())[0])
        return share * self._focus_motion(tonebursts, time_ps, origin_ps)

    def _placing(self, box: int) -> np.random.Generator:
        """Return what places the scatterers of the ``box``-th of a row of boxes, that on the axis the 0th."""
        return np.random.default_rng(
            np.random.SeedSequence(self._settings.seed, spawn_key=(_SCATTERER_STREAM, box % 2**32))
        )

    def record_volts(self, tonebursts: Bursts, pulses: Bursts, capture: Capture) -> FloatArray:
        """Return what reaches the digitizer's input, float64 (record, sample), V.

        Echoes of every tracking pulse and toneburst that fall into a record, toneburst leak, and noise. The noise
        depends on seed, ``capture.index`` and the record's number in the capture alone, the scatterers on the seed
        alone. Records must ascend in time; ``pulses`` may lack those that no record hears.
        """
        noise = self._noise.begin(capture)
        self._add_tracking_echoes(noise, tonebursts, pulses, capture)
        self._add_toneburst_echoes(noise, tonebursts, capture)
        self._add_leak(noise(), tonebursts, capture)
        return noise()

    def _add_tracking_echoes(self, volts: Begun, tonebursts: Bursts, pulses: Bursts, capture: Capture) -> None:
        strength_v = self._gain_v * pulse_strength(pulses, self._settings.receiver)
        strength_v *= transmitted_share(pulses.amplitude_vpp, self._settings)
        # not np.unique, here and below: it loads NumPy's masked arrays
        for carrier_hz in sorted(set(pulses.carrier_hz.tolist())):
            alike = pulses.carrier_hz == carrier_hz
            shape = echo_pulse(self._settings, carrier_hz)
            passage = self._passage(pulses.onset_ps[alike], capture)
            motion_m = self._motion_sensed_m(tonebursts, passage.time_ps, capture)
            heard = self._hear(shape, self._field.tracking_weight)
            self._add_echoes(volts, capture, heard, passage, strength_v[alike], motion_m)

    def _add_toneburst_echoes(self, volts: Begun, tonebursts: Bursts, capture: Capture) -> None:
        """Add the echoes of the tonebursts; a scatterer's motion during its burst is left out."""
        heard = near(tonebursts, capture)
        strength_v = self._gain_v * toneburst_echo_strength(heard, self._settings.receiver)
        length_s = (heard.end_ps - heard.onset_ps) / PS_PER_S
        for kind in sorted(set(zip(heard.carrier_hz.tolist(), length_s.tolist(), strict=True))):
            alike = (heard.carrier_hz == kind[0]) & (length_s == kind[1])
            shape = attenuated_to_focus(self._settings, rectangular_burst(*kind))
            # from another transducer they come as from this one, at another time
            passage = self._passage(heard.onset_ps[alike] + to_ps(self._push_later_s), capture)
            motion_m = self._motion_sensed_m(tonebursts, passage.time_ps, capture)
            through = self._hear(shape, self._field.excitation_weight, of_push=True)
            self._add_echoes(volts, capture, through, passage, strength_v[alike], motion_m)

    def _hear(self, shape: Pulse, gaussian_weight: FloatArray, of_push: bool = False) -> Heard:
        """Return what is heard by ``shape`` through a beam of ``gaussian_weight``, or through the aperture's own."""
        if self._settings.beams.field == "gaussian":
            return Heard(shape, gaussian_weight)
        if shape not in self._heard:
            made = coloured(self._settings, self._field.offset_m, shape, of_push)
            self._heard[shape] = Heard(shape, made.weight * self._field.strength, made.colour, made.sensed)
        return self._heard[shape]

    def _add_leak(self, volts: FloatArray, tonebursts: Bursts, capture: Capture) -> None:
        leak_per_vpp = leak_per_vpp_v(self._settings)
        if leak_per_vpp == 0:
            return
        pairs = burst_record_pairs(tonebursts.onset_ps, tonebursts.end_ps, capture)
        for burst, record in zip(*pairs, strict=True):
            begin_ps = int(capture.first_sample_ps[record])
            onset_ps, end_ps = int(tonebursts.onset_ps[burst]), int(tonebursts.end_ps[burst])
            span = sample_span(onset_ps - begin_ps, end_ps - begin_ps, capture)
            age_ps = begin_ps - onset_ps + np.arange(span.start, span.stop) * capture.sample_period_ps
            amplitude_v = leak_per_vpp * tonebursts.amplitude_vpp[burst]
            volts[record, span] += leak_v(amplitude_v, tonebursts.carrier_hz[burst], age_ps)

    def _passage(self, onset_ps: Int64Array, capture: Capture) -> Passage:
        """Return when bursts of ``onset_ps`` (burst,) pass the focus, which the background has moved."""
        time_ps = onset_ps + to_ps(self._travel_s)
        if self._background_m is None:
            return Passage(onset_ps, time_ps, None)
        # A focus farther away is reached later, by some us, in which the background moves by less than a sample.
        moved_m = self._background_m(time_ps - capture.origin_ps)
        later_s = moved_m / self._settings.sound_speed_m_per_s
        time_ps = time_ps + np.rint(later_s * PS_PER_S).astype(np.int64)
        moved_m = self._background_m(time_ps - capture.origin_ps)
        return Passage(onset_ps, time_ps, moved_m * (2 / self._settings.sound_speed_m_per_s))

    def _motion_sensed_m(self, tonebursts: Bursts, passage_ps: Int64Array, capture: Capture) -> FloatArray:
        """Return the amplitude of every motion shape when pulses pass, at ``passage_ps`` (burst,): (burst, shape)."""
        if self._medium is not None:
            return self._medium.amplitudes_m(tonebursts, passage_ps)
        if self._focus_motion is None:
            return np.zeros((len(passage_ps), 1))
        return self._focus_motion(tonebursts, passage_ps, capture.origin_ps)[:, None]

    def _add_echoes(
        self,
        begun: Begun,
        capture: Capture,
        heard: Heard,
        passage: Passage,
        strength_v: FloatArray,
        motion_m: FloatArray,
    ) -> None:
        """Add the echoes of like pulses, everything from their onset on, to the records they meet."""
        shape, seen = heard.shape, noticeable(heard.weight)
        if not (strength_v.any() and seen.any()):
            return
        # What can be seen, how it moves, and by how much that may shift its echo.
        delay_s = self._delay_s[seen]
        shapes = (self._field.motion_weight[None] if self._medium is None else self._medium.shape)[:, seen]
        if heard.sensed is not None:
            shapes = shapes * heard.sensed[seen]
        weight, colour = heard.weight[seen], None if heard.colour is None else heard.colour[:, seen]
        reach_m = float(np.abs(motion_m).max(axis=0) @ np.abs(shapes).max(axis=1))
        margin_s = 2 * reach_m / self._settings.sound_speed_m_per_s
        arrival_s = 2 * self._travel_s
        early_ps = math.floor((arrival_s + delay_s.min() + shape.start_s - margin_s) * PS_PER_S)
        late_ps = math.ceil((arrival_s + delay_s.max() + shape.end_s + margin_s) * PS_PER_S)
        if passage.delay_s is not None:
            delays = EchoDelays(delay_s, shapes, motion_m * (2 / self._settings.sound_speed_m_per_s), colour)
            met_ps = slice(early_ps, late_ps)
            self._add_shifted_echoes(begun(), capture, shape, weight, delays, passage, strength_v, met_ps)
            return
        onset_ps = passage.onset_ps
        # Pairs of burst and record whose echo falls into a sample; each is one echo of the engine, all on one grid of
        # sample times: that of the first pair, from which the others are shifted by up to some ns.
        burst, record = burst_record_pairs(onset_ps + early_ps, onset_ps + late_ps, capture)
        if len(burst) == 0:
            return
        age_ps = capture.first_sample_ps[record] - onset_ps[burst]
        span = sample_span(early_ps - int(age_ps.max()), late_ps - int(age_ps.min()), capture)
        sample_ps = int(age_ps[0]) + np.arange(span.start, span.stop) * capture.sample_period_ps
        tolerance = self._settings.scatterers.echo_tolerance or (
            _ECHO_TOLERANCE if self._medium is None else _FIELD_ECHO_TOLERANCE
        )
        # Each echo is made once, however often the motion repeats itself.
        speed_m_per_s, shift_s = self._settings.sound_speed_m_per_s, (age_ps - age_ps[0]) / PS_PER_S
        amplitude_s = np.concatenate([motion_m[burst] * (2 / speed_m_per_s), shift_s[:, None]], axis=1)
        one, kind = distinct_echoes(amplitude_s, np.pad(shapes, ((0, 1), (0, 0)), constant_values=1), shape, tolerance)
        decided_by = motion_m[burst[one]], shift_s[one], sample_ps
        block = self._made_before(shape, decided_by)
        if block is None:
            sample_s = _after_arrival_s(sample_ps, arrival_s)
            block = echoes(
                delay_s,
                weight,
                shapes,
                decided_by[0],
                shape,
                sample_s,
                speed_m_per_s,
                tolerance,
                shift_s=decided_by[1],
                colour=colour,
            )
            if len(one) <= _MOST_REPEATED:
                self._repeated[shape] = decided_by, block
                if len(self._repeated) > _MOST_PULSES:
                    del self._repeated[next(iter(self._repeated))]
        volts = begun()
        if np.array_equal(record, np.arange(len(volts))):
            _add_to_records(volts[:, span], block, kind, strength_v[burst])
            return
        block = block[kind] * strength_v[burst, None]
        if len(set(record.tolist())) == len(record):
            volts[record, span] += block
        else:
            np.add.at(volts[:, span], record, block)

    def _made_before(self, shape: Pulse, decided_by: tuple[FloatArray, FloatArray, Int64Array]) -> FloatArray | None:
        """Return the echoes of ``shape`` that the latest records before had, where the same numbers decide them."""
        before, block = self._repeated.get(shape, ((), None))
        same = len(before) == len(decided_by) and all(map(np.array_equal, before, decided_by))
        return block if same else None

    def _add_shifted_echoes(
        self,
        volts: FloatArray,
        capture: Capture,
        shape: Pulse,
        weight: FloatArray,
        delays: EchoDelays,
        passage: Passage,
        strength_v: FloatArray,
        heard_ps: slice,
    ) -> None:
        """Add echoes that the background shifts as a whole, by any number of samples.

        Every echo is worked out whole, on a grid of samples that moves with the specimen, and lands in its record as
        many samples later; what is left of the shift, less than half a sample, is a shape of ones.
        """
        assert passage.delay_s is not None  # noqa: S101
        period_ps, delay_ps = capture.sample_period_ps, passage.delay_s * PS_PER_S
        late_ps = np.rint(delay_ps).astype(np.int64) + passage.onset_ps
        burst, record = burst_record_pairs(late_ps + heard_ps.start, late_ps + heard_ps.stop, capture)
        if len(burst) == 0:
            return
        # The grid's sample times after a pulse's onset are whole periods, those of a record's samples anything.
        age_ps = capture.first_sample_ps[record] - passage.onset_ps[burst] - delay_ps[burst]
        place = np.rint(age_ps / period_ps).astype(np.int64)
        grid = np.arange(heard_ps.start // period_ps, heard_ps.stop // period_ps + 2)
        block = echoes(
            delays.rest_s,
            weight,
            delays.shape,
            delays.amplitude_s[burst] * (self._settings.sound_speed_m_per_s / 2),
            shape,
            _after_arrival_s(grid * period_ps, 2 * self._travel_s),
            self._settings.sound_speed_m_per_s,
            _FIELD_ECHO_TOLERANCE,
            shift_s=(age_ps - place * period_ps) / PS_PER_S,
            colour=delays.colour,
        )
        block *= strength_v[burst, None]
        for echo, into, first in zip(block, record.tolist(), (grid[0] - place).tolist(), strict=True):
            # Of the echo, whose first sample falls on the record's sample ``first``, what the record holds.
            begin, end = max(0, first), min(capture.samples, first + len(echo))
            if begin < end:
                volts[into, begin:end] += echo[begin - first : end - first]


def _add_to_records(volts: FloatArray, block: FloatArray, kind: Int64Array, strength_v: FloatArray) -> None:
    """Add to every record (record, sample) its ``kind`` (record,) of echo (kind, sample), by its strength (record,)."""
    alike = bool((strength_v == strength_v[0]).all())
    if alike:
        block = block * strength_v[0]
    # no copy of all samples on the way: some records at a time stay in the cache
    for first in range(0, len(volts), _RECORDS_AT_ONCE):
        some = slice(first, first + _RECORDS_AT_ONCE)
        volts[some] += block[kind[some]] if alike else block[kind[some]] * strength_v[some, None]


def transmitted_share(amplitude_vpp: FloatArray, settings: SimulationSettings) -> FloatArray:
    """Return what hybrid, amplifier and diodes leave of tracking pulses (burst,), over that of the reference pulse.

    The carrier alone: its harmonics lie outside the receive band. They are the push's: to a tracking transducer of its
    own pulses go another way, which is linear.
    """
    if settings.transmitter.linear or settings.beams.tracking_focus_depth_m is not None:
        return np.ones_like(amplitude_vpp)
    from sim_backend.motion import harmonic_v

    reference_vpp = settings.receiver.reference_pulse_vpp
    left, of_reference = (
        harmonic_v(vpp, settings.transmitter) / vpp for vpp in (amplitude_vpp, np.array([reference_vpp]))
    )
    return left / of_reference if of_reference[0] > 0 else np.zeros_like(amplitude_vpp)


def burst_record_pairs(start_ps: Int64Array, end_ps: Int64Array, capture: Capture) -> tuple[Int64Array, Int64Array]:
    """Return burst and record index of every pair in which the interval (burst,) holds a sample's time, ends included.

    Records must begin in time order, as triggers do.
    """
    first_ps = capture.first_sample_ps
    last_ps = first_ps + (capture.samples - 1) * capture.sample_period_ps
    begin = np.searchsorted(last_ps, start_ps, side="left")
    count = np.maximum(np.searchsorted(first_ps, end_ps, side="right") - begin, 0)
    burst = np.repeat(np.arange(len(start_ps)), count)
    position = np.arange(len(burst)) - np.repeat(np.cumsum(count) - count, count)
    return burst, np.asarray(np.repeat(begin, count) + position)


def sample_span(start_ps: int, end_ps: int, capture: Capture) -> slice:
    """Return the samples of a record whose times after its first sample lie in the interval, ends included."""
    first = max(0, -(-start_ps // capture.sample_period_ps))
    last = min(capture.samples, end_ps // capture.sample_period_ps + 1)
    return slice(first, max(first, last))


def _focus_motion(settings: SimulationSettings, travel_s: float) -> FocusMotion | None:
    """Return what moves the focus, or None; the medium's transient is tabulated once, here."""
    if settings.specimen is not None:
        from sim_backend.motion import (
            focus_response,
            force_shape,
            force_share,
            radiation_force,
            transient_displacement,
        )

        specimen = settings.specimen
        response, share = focus_response(specimen, force_shape(settings)), force_share(settings)
        return lambda tonebursts, time_ps, _origin_ps: transient_displacement(
            response, radiation_force(tonebursts, specimen, travel_s, settings.transmitter, share), time_ps
        )
    if settings.motion:
        from sim_backend.motion import motion_at

        components = settings.motion
        return lambda _tonebursts, time_ps, origin_ps: motion_at(components, time_ps - origin_ps)
    return None


def _background_motion(settings: SimulationSettings) -> Callable[[Int64Array], FloatArray] | None:
    """Return how far the whole specimen has moved at times after the master trigger, or None."""
    if not settings.background:
        return None
    from sim_backend.motion import background_at

    return lambda time_ps: background_at(settings.background, time_ps)


def _medium_motion(
    settings: SimulationSettings, scatterers: ScattererField, travel_s: float, beside_m: float
) -> MediumMotion | None:
    """Return how the medium's own field moves the scatterers; None where they move by the Gaussian of eq. (12)."""
    if settings.specimen is None or settings.specimen.field == "gaussian":
        return None
    from sim_backend.motion import medium_motion

    motion = medium_motion(settings, scatterers.offset_m, travel_s, beside_m)
    return replace(motion, shape=motion.shape * scatterers.moves)


def _after_arrival_s(sample_ps: Int64Array, arrival_s: float) -> FloatArray:
    """Return sample times after the focus' echo: integers are subtracted first, so no digit of the phase is lost."""
    whole_ps = to_ps(arrival_s)
    return np.asarray((sample_ps - whole_ps) / PS_PER_S - (arrival_s - whole_ps / PS_PER_S))
