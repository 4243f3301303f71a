"""Acoustics of the twin, from the generators' outputs to the digitizer's input: bursts in, volts out.

    tonebursts -> force -> displacement at the focus -> scatterers -> echoes -> front end

    v(t) = sum_k A_k r_k(t - t_k) + toneburst leak + noise        eq. (7) to (16)

    A_k    strength of burst k, V
    r_k    its echo (sim_backend.echoes); t_k its onset

A part that the settings leave out is not imported, drawn or summed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from sim_backend.arrays import BoolArray, FloatArray, Int64Array
from sim_backend.echoes import (
    BeamResponse,
    EchoDelays,
    Pulse,
    ScattererField,
    attenuated_to_focus,
    beam_response,
    depth_delay_s,
    distinct_echoes,
    draw_field,
    echo_pulse,
    gaussian_weight,
    noticeable,
    rectangular_burst,
    synthesise,
)
from sim_backend.receiver import (
    RecordStream,
    echo_gain_v,
    leak_per_vpp_v,
    leak_v,
    noise_v,
    pulse_strength,
    toneburst_echo_strength,
)
from sim_backend.settings import SimulationSettings
from sim_backend.wiring import PS_PER_S, Bursts, Capture, near, to_ps

if TYPE_CHECKING:
    from sim_backend.motion import MediumMotion

FocusMotion = Callable[[Bursts, Int64Array, int], FloatArray]
"""Displacement of the focus, m, from tonebursts, times and the master trigger's edge."""

# Children of the seed. Another value of either would give old scenes new data.
_SCATTERER_STREAM = 0
_NOISE_STREAM = 1

# Relative error of the echoes. A thousandth of a 14-bit code of a full-scale echo is 1e-7; as motion that is 1 pm.
_ECHO_TOLERANCE = 1e-8
_FIELD_ECHO_TOLERANCE = 2e-7  # many shapes, of a medium's field or of pulses that start between samples


@dataclass(frozen=True, slots=True)
class _FocusPassage:
    """Passage of bursts through the focus; every array (burst,)."""

    onset_ps: Int64Array
    time_ps: Int64Array
    """Time at the focus."""
    background_delay_s: FloatArray | None
    """Delay of the echoes by the background motion; None without background."""


@dataclass(frozen=True, slots=True)
class _EchoTrain:
    """Echoes of equal bursts."""

    pulse: Pulse
    passage: _FocusPassage
    strength_v: FloatArray
    """(burst,)"""
    weight: FloatArray
    """(scatterer,)"""
    delays: EchoDelays
    """An echo for each burst."""
    start_ps: int
    """Earliest start of an echo after the onset of its burst."""
    end_ps: int
    """Latest end of an echo after the onset of its burst."""


class Acoustics:
    """Specimen, scatterers and receiver of one world; all captures share the scatterers.

    The tracking transducer is ``lateral_offset_m`` off the push along x, in addition to the axis in ``settings.beams``.
    """

    def __init__(self, settings: SimulationSettings, lateral_offset_m: float = 0.0) -> None:
        """Draw the scatterers of ``settings``, and prepare noise, gain and motion of the medium."""
        x, y = settings.beams.lateral_offset_m
        beams = settings.beams.model_copy(update={"lateral_offset_m": (x + lateral_offset_m, y)})
        self._settings = settings = settings.model_copy(update={"beams": beams})
        self._lateral_offset_m = lateral_offset_m
        # Travel time from the tracking transducer to the focus, and the additional time from the pushing one.
        self._travel_s = settings.beams.tracked_from_m / settings.sound_speed_m_per_s
        self._push_delay_s = settings.beams.focus_depth_m / settings.sound_speed_m_per_s - self._travel_s
        push_travel_s = self._travel_s + self._push_delay_s
        # Around the focus the specimen attenuates echoes, if its depth is stated.
        loss = {"attenuation_db_per_cm_mhz": settings.echo_attenuation_db_per_cm_mhz}
        scatterers = settings.scatterers.model_copy(update=loss)
        rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(_SCATTERER_STREAM,)))
        self._field = draw_field(scatterers, settings.beams, rng, lateral_offset_m, self._box_rng)
        self._noise = RecordStream(settings.seed, _NOISE_STREAM)
        self._delay_s = depth_delay_s(self._field, settings.scatterers.axial_delay, settings.sound_speed_m_per_s)
        self._aperture_beams: dict[Pulse, BeamResponse] = {}
        # The gain gives the echoes of the reference pulse the signal-to-noise ratio that the settings state.
        reference_pulse = echo_pulse(settings, settings.receiver.reference_carrier_hz)
        reference = self._beam(reference_pulse, self._field.tracking_weight)
        self._gain_v = echo_gain_v(settings, self._delay_s, reference.weight, reference.response)
        self._focus_motion = _focus_motion(settings, push_travel_s)
        self._medium = _medium_motion(settings, self._field, push_travel_s, lateral_offset_m)

    def focus_displacement_m(
        self, tonebursts: Bursts, time_ps: Int64Array, origin_ps: int, *, index: int = 0
    ) -> FloatArray:
        """Return the displacement (time,) at ``time_ps``, m, positive away from the transducer.

        The point is the focus, or on the axis of a tracking transducer that is off the push. ``tonebursts`` move a
        specimen; a prescribed motion counts from ``origin_ps``, the master trigger's edge. Zeros without either.
        """
        if self._focus_motion is None:
            return np.zeros(len(time_ps))
        if self._lateral_offset_m and self._medium is not None:
            return self._medium.displacement_m(tonebursts, time_ps, self._lateral_offset_m)
        point_m = np.array([[self._lateral_offset_m, 0.0, 0.0]])
        motion_weight = float(gaussian_weight(point_m, self._settings.beams.motion_width_m())[0])
        return motion_weight * self._focus_motion(tonebursts, time_ps, origin_ps)

    def _box_rng(self, box: int) -> np.random.Generator:
        """Return the generator that draws the scatterers of a ``box`` in a row of boxes, 0 on the axis."""
        return np.random.default_rng(
            np.random.SeedSequence(self._settings.seed, spawn_key=(_SCATTERER_STREAM, box % 2**32))
        )

    def record_volts(self, tonebursts: Bursts, pulses: Bursts, capture: Capture) -> FloatArray:
        """Return the voltage at the digitizer's input, float64 (record, sample), V.

        It contains the echoes of all tracking pulses and tonebursts in a record, toneburst leak, and noise. The noise
        depends only on the seed, ``capture.index`` and the record's number in the capture, the scatterers only on the
        seed. Records must ascend in time; ``pulses`` may omit pulses without an echo in a record.
        """
        receiver, records = self._settings.receiver, len(capture.first_sample_ps)
        if receiver.snr_db is None:
            volts = np.zeros((records, capture.samples))
        else:
            volts = noise_v(receiver, records, capture.samples, self._noise.generator_for(capture, capture.samples))
        self._add_tracking_echoes(volts, tonebursts, pulses, capture)
        self._add_toneburst_echoes(volts, tonebursts, capture)
        self._add_leak(volts, tonebursts, capture)
        return volts

    def _add_tracking_echoes(self, volts: FloatArray, tonebursts: Bursts, pulses: Bursts, capture: Capture) -> None:
        """Add the echoes of the tracking pulses to the records, one carrier after another."""
        strength_v = self._gain_v * pulse_strength(pulses, self._settings.receiver)
        # Sets instead of np.unique, which loads NumPy's masked arrays.
        for carrier_hz in sorted(set(pulses.carrier_hz.tolist())):
            selected = pulses.carrier_hz == carrier_hz
            passage = self._passage(pulses.onset_ps[selected], capture)
            pulse = echo_pulse(self._settings, carrier_hz)
            beam = self._beam(pulse, self._field.tracking_weight)
            self._add_echoes(volts, capture, pulse, beam, passage, strength_v[selected], tonebursts)

    def _add_toneburst_echoes(self, volts: FloatArray, tonebursts: Bursts, capture: Capture) -> None:
        """Add the echoes of the tonebursts to the records.

        The motion of a scatterer while a burst passes it is neglected. ``tonebursts`` contains the earlier ones too,
        which still move the scatterers; only those near ``capture`` echo.
        """
        bursts = near(tonebursts, capture)
        strength_v = self._gain_v * toneburst_echo_strength(bursts, self._settings.receiver)
        length_s = (bursts.end_ps - bursts.onset_ps) / PS_PER_S
        for carrier_and_length in sorted(set(zip(bursts.carrier_hz.tolist(), length_s.tolist(), strict=True))):
            selected = (bursts.carrier_hz == carrier_and_length[0]) & (length_s == carrier_and_length[1])
            pulse = attenuated_to_focus(self._settings, rectangular_burst(*carrier_and_length))
            # A separate pushing transducer changes only the time of the echoes.
            passage = self._passage(bursts.onset_ps[selected] + to_ps(self._push_delay_s), capture)
            beam = self._beam(pulse, self._field.excitation_weight, of_push=True)
            self._add_echoes(volts, capture, pulse, beam, passage, strength_v[selected], tonebursts)

    def _beam(self, pulse: Pulse, gaussian_weight: FloatArray, of_push: bool = False) -> BeamResponse:
        """Return the weight and, unless the beam is Gaussian, the response of every scatterer's echo for ``pulse``.

        ``gaussian_weight`` (scatterer,): weights in a Gaussian beam. ``of_push``: the beam is that of the tonebursts.
        """
        if self._settings.beams.field == "gaussian":
            return BeamResponse(gaussian_weight)
        if pulse not in self._aperture_beams:
            beam = beam_response(self._settings, self._field.offset_m, pulse, of_push)
            self._aperture_beams[pulse] = replace(beam, weight=beam.weight * self._field.reflectivity)
        return self._aperture_beams[pulse]

    def _add_leak(self, volts: FloatArray, tonebursts: Bursts, capture: Capture) -> None:
        """Add the leak of the tonebursts to the records during which they are transmitted."""
        leak_per_vpp = leak_per_vpp_v(self._settings)
        if leak_per_vpp == 0:
            return
        pairs = burst_record_pairs(tonebursts.onset_ps, tonebursts.end_ps, capture)
        for burst, record in zip(*pairs, strict=True):
            begin_ps = int(capture.first_sample_ps[record])
            onset_ps, end_ps = int(tonebursts.onset_ps[burst]), int(tonebursts.end_ps[burst])
            span = sample_span(onset_ps - begin_ps, end_ps - begin_ps, capture)
            # Time of each sample after the onset of the burst.
            age_ps = begin_ps - onset_ps + np.arange(span.start, span.stop) * capture.sample_period_ps
            amplitude_v = leak_per_vpp * tonebursts.amplitude_vpp[burst]
            volts[record, span] += leak_v(amplitude_v, tonebursts.carrier_hz[burst], age_ps)

    def _passage(self, onset_ps: Int64Array, capture: Capture) -> _FocusPassage:
        """Return when bursts with ``onset_ps`` (burst,) pass the focus.

        The result includes the delay of their echoes by the specimen's background motion.
        """
        time_ps = onset_ps + to_ps(self._travel_s)
        background, sound_speed_m_per_s = self._settings.background, self._settings.sound_speed_m_per_s
        if not background:
            return _FocusPassage(onset_ps, time_ps, None)
        from sim_backend.motion import background_at

        # The background moves the specimen, so that a burst reaches the focus some us later or earlier. One correction
        # suffices: the background is slow, and in these us moves by far less than the sound does in a sample period.
        later_s = background_at(background, time_ps - capture.origin_ps) / sound_speed_m_per_s
        time_ps = time_ps + np.rint(later_s * PS_PER_S).astype(np.int64)
        moved_m = background_at(background, time_ps - capture.origin_ps)
        return _FocusPassage(onset_ps, time_ps, moved_m * (2 / sound_speed_m_per_s))

    def _motion_amplitudes_m(self, tonebursts: Bursts, passage_ps: Int64Array, capture: Capture) -> FloatArray:
        """Return the amplitude of each spatial shape of the motion when bursts pass the focus, m (burst, shape).

        The displacement of a scatterer is the sum of amplitude times shape. ``passage_ps`` (burst,): time at the focus.
        """
        if self._medium is not None:
            return self._medium.amplitudes_m(tonebursts, passage_ps)
        if self._focus_motion is None:
            return np.zeros((len(passage_ps), 1))
        return self._focus_motion(tonebursts, passage_ps, capture.origin_ps)[:, None]

    def _add_echoes(
        self,
        volts: FloatArray,
        capture: Capture,
        pulse: Pulse,
        beam: BeamResponse,
        passage: _FocusPassage,
        strength_v: FloatArray,
        tonebursts: Bursts,
    ) -> None:
        """Add the echoes of a train of equal bursts to the records.

        ``pulse``: echo of a scatterer at the focus. ``beam``: its weight and change for every scatterer. ``passage``:
        when the bursts pass the focus. ``strength_v`` (burst,): volts of a scatterer of weight 1. ``tonebursts`` move
        the specimen meanwhile.
        """
        motion_m = self._motion_amplitudes_m(tonebursts, passage.time_ps, capture)
        relevant = noticeable(beam.weight)
        if not (strength_v.any() and relevant.any()):
            return
        train = self._echo_train(pulse, beam, relevant, passage, strength_v, motion_m)
        if passage.background_delay_s is None:
            self._add_aligned_echoes(volts, capture, train)
        else:
            self._add_shifted_echoes(volts, capture, train, passage.background_delay_s)

    def _echo_train(
        self,
        pulse: Pulse,
        beam: BeamResponse,
        relevant: BoolArray,
        passage: _FocusPassage,
        strength_v: FloatArray,
        motion_m: FloatArray,
    ) -> _EchoTrain:
        """Return the echoes of a train of equal bursts from moving scatterers, and when they arrive.

        ``relevant`` (scatterer,): whether it echoes at all. ``motion_m`` (burst, shape): amplitude of each spatial
        shape of the motion, at each burst.
        """
        # Spatial shapes of the motion, (shape, scatterer).
        shapes = (self._field.motion_weight[None] if self._medium is None else self._medium.shape)[:, relevant]
        if beam.delay_ratio is not None:
            shapes = shapes * beam.delay_ratio[relevant]
        response = None if beam.response is None else beam.response[:, relevant]
        delay_s, sound_speed_m_per_s = self._delay_s[relevant], self._settings.sound_speed_m_per_s
        # The largest displacement extends the interval of arrival on both sides.
        reach_m = float(np.abs(motion_m).max(axis=0) @ np.abs(shapes).max(axis=1))
        margin_s, focus_s = 2 * reach_m / sound_speed_m_per_s, 2 * self._travel_s
        start_s = focus_s + delay_s.min() + pulse.start_s - margin_s
        end_s = focus_s + delay_s.max() + pulse.end_s + margin_s
        return _EchoTrain(
            pulse=pulse,
            passage=passage,
            strength_v=strength_v,
            weight=beam.weight[relevant],
            delays=EchoDelays.of_motion(delay_s, shapes, motion_m, sound_speed_m_per_s, response),
            start_ps=math.floor(start_s * PS_PER_S),
            end_ps=math.ceil(end_s * PS_PER_S),
        )

    def _add_aligned_echoes(self, volts: FloatArray, capture: Capture, train: _EchoTrain) -> None:
        """Add echoes to the records, for records that sample them at nearly the same times after the onset of a burst.

        Those times differ by some ns at most, so all echoes are computed on one grid of sample times.
        """
        onset_ps = train.passage.onset_ps
        burst, record = burst_record_pairs(onset_ps + train.start_ps, onset_ps + train.end_ps, capture)
        if len(burst) == 0:
            return
        # Age: time of a record's first sample after the onset. The grid is that of the first pair of burst and record;
        # the other pairs are shifted from it.
        age_ps = capture.first_sample_ps[record] - onset_ps[burst]
        span = sample_span(train.start_ps - int(age_ps.max()), train.end_ps - int(age_ps.min()), capture)
        sample_ps = int(age_ps[0]) + np.arange(span.start, span.stop) * capture.sample_period_ps
        shift_s = (age_ps - age_ps[0]) / PS_PER_S
        sample_s = _after_arrival_s(sample_ps, 2 * self._travel_s)
        distinct_echo, group = self._distinct_echoes(train, burst, shift_s, sample_s)
        echo_v = distinct_echo[group] * train.strength_v[burst, None]
        if np.array_equal(record, np.arange(len(volts))):
            volts[:, span] += echo_v
        else:
            # Records without an echo, or with several.
            np.add.at(volts[:, span], record, echo_v)

    def _distinct_echoes(
        self, train: _EchoTrain, burst: Int64Array, shift_s: FloatArray, sample_s: FloatArray
    ) -> tuple[FloatArray, Int64Array]:
        """Return the echoes that differ, each computed once, (group, sample), and the group of each pair, (pair,).

        A pair is a burst and a record of its echo. Many pairs have the same echo, for example those one period of the
        motion apart. ``burst`` (pair,): index of the burst. ``shift_s`` (pair,): how much later than ``sample_s`` the
        record's samples are. ``sample_s`` (sample,): times after the arrival of the echo of the focus.
        """
        delays = train.delays
        tolerance = self._settings.scatterers.echo_tolerance or (
            _ECHO_TOLERANCE if self._medium is None else _FIELD_ECHO_TOLERANCE
        )
        # The delay of a scatterer changes by the sum of amplitudes times shapes. The shift delays all scatterers
        # equally: it is the amplitude of one more shape, of ones.
        amplitude_s = np.concatenate([delays.amplitude_s[burst], shift_s[:, None]], axis=1)
        shapes = np.concatenate([delays.shape, np.ones((1, delays.shape.shape[1]))])
        # Pairs with equal amplitudes form a group, which the first of its pairs represents.
        first, group = distinct_echoes(amplitude_s, shapes, train.pulse, tolerance)
        group_delays = replace(delays, amplitude_s=delays.amplitude_s[burst[first]]).shifted(shift_s[first])
        return synthesise(group_delays, train.weight, train.pulse, sample_s, tolerance).echo, group

    def _add_shifted_echoes(
        self, volts: FloatArray, capture: Capture, train: _EchoTrain, background_delay_s: FloatArray
    ) -> None:
        """Add echoes to the records, for a background motion that delays them by any number of samples.

        ``background_delay_s`` (burst,): delay of each burst's echoes by the background motion. The time from a delayed
        onset to its record is split into whole samples and a remainder of at most half a sample. An echo is computed
        with its scatterers' delays shifted by the remainder, then added to the record at the whole-sample position.
        """
        onset_ps, period_ps = train.passage.onset_ps, capture.sample_period_ps
        delay_ps = background_delay_s * PS_PER_S
        delayed_onset_ps = np.rint(delay_ps).astype(np.int64) + onset_ps
        burst, record = burst_record_pairs(delayed_onset_ps + train.start_ps, delayed_onset_ps + train.end_ps, capture)
        if len(burst) == 0:
            return
        # Time from the delayed onset to a record's first sample: whole sample periods, and the remainder ``shift_s``.
        age_ps = capture.first_sample_ps[record] - onset_ps[burst] - delay_ps[burst]
        age_periods = np.rint(age_ps / period_ps).astype(np.int64)
        shift_s = (age_ps - age_periods * period_ps) / PS_PER_S
        # Sample times of the echoes in periods after the delayed onset.
        periods = np.arange(train.start_ps // period_ps, train.end_ps // period_ps + 2)
        delays = replace(train.delays, amplitude_s=train.delays.amplitude_s[burst]).shifted(shift_s)
        sample_s = _after_arrival_s(periods * period_ps, 2 * self._travel_s)
        block = synthesise(delays, train.weight, train.pulse, sample_s, _FIELD_ECHO_TOLERANCE).echo
        block *= train.strength_v[burst, None]
        first_samples = (periods[0] - age_periods).tolist()
        for echo, target, first in zip(block, record.tolist(), first_samples, strict=True):
            # The echo starts at sample ``first`` of the record, which may be before the record; it may end after it.
            start, end = max(0, first), min(capture.samples, first + len(echo))
            if start < end:
                volts[target, start:end] += echo[start - first : end - first]


def burst_record_pairs(start_ps: Int64Array, end_ps: Int64Array, capture: Capture) -> tuple[Int64Array, Int64Array]:
    """Return the burst and the record of every pair with a sample between start and end (burst,), ends included.

    Records must be in time order, as triggers do.
    """
    first_ps = capture.first_sample_ps
    last_ps = first_ps + (capture.samples - 1) * capture.sample_period_ps
    first_record = np.searchsorted(last_ps, start_ps, side="left")
    count = np.maximum(np.searchsorted(first_ps, end_ps, side="right") - first_record, 0)
    # Burst i is in the records first_record[i] .. first_record[i] + count[i] - 1; ``position`` counts them from 0.
    burst = np.repeat(np.arange(len(start_ps)), count)
    position = np.arange(len(burst)) - np.repeat(np.cumsum(count) - count, count)
    return burst, np.asarray(np.repeat(first_record, count) + position)


def sample_span(start_ps: int, end_ps: int, capture: Capture) -> slice:
    """Return the samples of a record between start and end, both after its first sample and included."""
    first = max(0, -(-start_ps // capture.sample_period_ps))
    last = min(capture.samples, end_ps // capture.sample_period_ps + 1)
    return slice(first, max(first, last))


def _focus_motion(settings: SimulationSettings, travel_s: float) -> FocusMotion | None:
    """Return the displacement of the focus as a function of tonebursts, time and master trigger; None without motion.

    The response of a medium to a step of force is tabulated once, in this call. ``travel_s``: from the pushing
    transducer to the focus.
    """
    if settings.specimen is not None:
        from sim_backend import motion

        specimen, scale = settings.specimen, motion.force_scale(settings)
        response = motion.focus_response(specimen, motion.force_shape(settings))
        return lambda tonebursts, time_ps, _origin_ps: motion.transient_displacement(
            response, motion.radiation_force(tonebursts, specimen, travel_s, scale), time_ps
        )
    if settings.motion:
        from sim_backend.motion import motion_at

        components = settings.motion
        return lambda _tonebursts, time_ps, origin_ps: motion_at(components, time_ps - origin_ps)
    return None


def _medium_motion(
    settings: SimulationSettings, scatterers: ScattererField, travel_s: float, lateral_offset_m: float
) -> MediumMotion | None:
    """Return the motion of the scatterers by the medium's shear field.

    None if the field is the prescribed Gaussian of eq. (12) of the paper.
    """
    if settings.specimen is None or settings.specimen.field == "gaussian":
        return None
    from sim_backend.motion import medium_motion

    motion = medium_motion(settings, scatterers.offset_m, travel_s, lateral_offset_m)
    # Reflectors at rest do not move with the medium: their share is 0, that of all other scatterers 1.
    return replace(motion, shape=motion.shape * scatterers.motion_share)


def _after_arrival_s(sample_ps: Int64Array, arrival_s: float) -> FloatArray:
    """Return sample times after the echo of the focus; the integers are subtracted first, so no digits are lost."""
    whole_ps = to_ps(arrival_s)
    return np.asarray((sample_ps - whole_ps) / PS_PER_S - (arrival_s - whole_ps / PS_PER_S))
