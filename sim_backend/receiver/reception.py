"""Reception with trigger jitter, a receive chain and an imperfect sample clock around ideal acoustics.

    jittered bursts -> acoustics over a longer, finer record -> receive chain -> sample clock

`with_reception` adds it only if the settings contain one of these parts.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Protocol

from sim_backend.arrays import FloatArray, Int64Array
from sim_backend.receiver.streams import RecordStream
from sim_backend.receiver.timing import SLOPE_MARGIN, has_clock_error, jittered, sampled_with_clock_error
from sim_backend.settings import ReceiveChain, SimulationSettings
from sim_backend.wiring import PS_PER_S, Bursts, Capture, joined_bursts, no_bursts

# Numbers of the streams of random numbers, above those of the acoustics; every stream comes from the scene's seed.
_CHAIN_NOISE_STREAM = 100
_CLOCK_STREAM = 101
# Every scene's seed has four streams of trigger jitter, two of them in use: pulser and tonebursts are independent.
_JITTER_STREAMS = 4
# Stream, and number of jittering generators. The burst train's generator triggers that of the toneburst. The tracking
# train's jitter delays pulse and record alike, so only the pulser's moves echoes in a record.
_PULSE_JITTER, _TONEBURST_JITTER = (1, 1), (2, 2)


class Physics(Protocol):
    """Acoustics: transmitted bursts -> received volts, in blocks of consecutive records."""

    def record_volts(self, tonebursts: Bursts, pulses: Bursts, capture: Capture) -> FloatArray: ...

    def focus_displacement_m(
        self, tonebursts: Bursts, time_ps: Int64Array, origin_ps: int, *, index: int = 0
    ) -> FloatArray: ...


def with_reception(acoustics: Physics, settings: SimulationSettings) -> Physics:
    """Return ``acoustics`` with receive chain, trigger jitter and clock error of the settings, if there are any."""
    instruments = settings.instruments
    is_ideal = settings.receive_chain is None and instruments.trigger_jitter_s <= 0 and not has_clock_error(instruments)
    return acoustics if is_ideal else Reception(acoustics, settings)


class Reception:
    """Trigger jitter, receive chain and sample clock around ideal acoustics."""

    def __init__(self, acoustics: Physics, settings: SimulationSettings) -> None:
        """Prepare the random numbers of chain noise and clock jitter; ``acoustics`` simulates the echoes."""
        self._acoustics = acoustics
        self._settings = settings
        self._chain_noise = RecordStream(settings.seed, _CHAIN_NOISE_STREAM)
        self._clock_jitter = RecordStream(settings.seed, _CLOCK_STREAM)

    def focus_displacement_m(
        self, tonebursts: Bursts, time_ps: Int64Array, origin_ps: int, *, index: int = 0
    ) -> FloatArray:
        """Return the displacement at the focus at ``time_ps`` (time,), m, under the jittered tonebursts."""
        jittered_bursts = self._jittered(tonebursts, *_TONEBURST_JITTER, origin_ps, index)
        return self._acoustics.focus_displacement_m(jittered_bursts, time_ps, origin_ps)

    def record_volts(self, tonebursts: Bursts, pulses: Bursts, capture: Capture) -> FloatArray:
        """Return the voltages that the digitizer samples, float64 (record, sample), V: echoes after receive chain."""
        tonebursts = self._jittered(tonebursts, *_TONEBURST_JITTER, capture.origin_ps, capture.index)
        pulses = self._jittered(pulses, *_PULSE_JITTER, capture.origin_ps, capture.index)
        # Longer and finer records, so that the chain and the clock have the samples they need.
        padded_capture, selected = widened(self._settings, capture)
        volts = self._acoustics.record_volts(tonebursts, pulses, padded_capture)
        chain = self._settings.receive_chain
        if chain is not None:
            volts = self._received(volts, chain, tonebursts, pulses, padded_capture)
        if not has_clock_error(self._settings.instruments):
            return volts[:, selected]
        period_s = capture.sample_period_ps / PS_PER_S
        rng = self._clock_jitter.generator_for(capture, capture.samples)
        return sampled_with_clock_error(volts, selected, period_s, self._settings.instruments, rng)

    def _received(
        self, volts: FloatArray, chain: ReceiveChain, tonebursts: Bursts, pulses: Bursts, padded_capture: Capture
    ) -> FloatArray:
        """Return the output of the receive chain for ``volts`` (record, sample) at the transducer.

        ``padded_capture``: times of the samples, with margins for the transients of the filters.
        """
        from sim_backend.receiver.chain import receive
        from sim_backend.receiver.elements import switch_gain

        # ``volts`` lacks the third harmonics of the tonebursts, which leak and echo too: add them.
        harmonic_bursts = third_harmonics(tonebursts, chain.third_harmonic)
        if harmonic_bursts.onset_ps.size:
            volts = volts + self._acoustics.record_volts(harmonic_bursts, no_bursts(), padded_capture)
        # The transmit/receive switch recovers after each burst and pulse.
        switch_gains = None
        if chain.recovery_time_s is not None:
            switch_gains = switch_gain(joined_bursts([tonebursts, pulses]), padded_capture, chain.recovery_time_s)
        rng = None
        if chain.noise_v_per_sqrt_hz:
            rng = self._chain_noise.generator_for(padded_capture, padded_capture.samples)
        return receive(volts, chain, padded_capture.sample_period_ps / PS_PER_S, switch_gains, rng)

    def _jittered(self, bursts: Bursts, stream: int, generators: int, origin_ps: int, index: int) -> Bursts:
        """Return ``bursts`` shifted by the random jitter of their triggers.

        The seed, ``stream`` (one for each train), the capture's number ``index`` and the onset relative to the master
        trigger's edge ``origin_ps`` determine the jitter of a burst. ``generators`` in series add independent jitters,
        so that the rms grows with the square root of their number.
        """
        rms_s = self._settings.instruments.trigger_jitter_s * math.sqrt(generators)
        stream_seed = self._settings.seed * _JITTER_STREAMS + stream
        return jittered(bursts, rms_s=rms_s, seed=stream_seed, origin_ps=origin_ps, index=index)


def widened(settings: SimulationSettings, capture: Capture) -> tuple[Capture, slice]:
    """Return the longer and finer capture that chain and clock need, and the slice of its samples to return.

    Finer by the oversampling of the receive chain. Longer at both ends: clock errors need the slope of a sample, hence
    its neighbours, and the filters of the chain ring. Slice and capture count fine samples.
    """
    chain = settings.receive_chain
    oversampling = 1 if chain is None else chain.oversampling
    period_ps = capture.sample_period_ps // oversampling
    fine_samples = capture.samples * oversampling
    # Numbers of additional samples before and after those of ``capture``.
    before = after = SLOPE_MARGIN if has_clock_error(settings.instruments) else 0
    if chain is not None:
        from sim_backend.receiver.chain import TRAILING_SAMPLES, fast_fft_length, settling_s

        settling = math.ceil(settling_s(chain) * PS_PER_S / period_ps)
        if settling:
            before += settling
            after += TRAILING_SAMPLES
        # Padded in front to a length with a fast Fourier transform.
        before = fast_fft_length(before + fine_samples + after) - fine_samples - after
    first_ps = capture.first_sample_ps - before * period_ps
    samples = before + fine_samples + after
    padded_capture = replace(capture, first_sample_ps=first_ps, sample_period_ps=period_ps, samples=samples)
    return padded_capture, slice(before, before + fine_samples, oversampling)


def third_harmonics(tonebursts: Bursts, ratio: float) -> Bursts:
    """Return the third harmonics of the tonebursts as separate bursts, ``ratio`` of their amplitude; none if zero.

    They leak and echo like the tonebursts; their force is neglected.
    """
    if ratio == 0:
        return no_bursts()
    return replace(
        tonebursts,
        carrier_hz=3 * tonebursts.carrier_hz,
        cycles=3 * tonebursts.cycles,
        amplitude_vpp=ratio * tonebursts.amplitude_vpp,
    )
