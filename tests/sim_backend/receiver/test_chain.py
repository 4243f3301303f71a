"""The receive chain: filters against closed forms and scipy, each element alone, nothing where nothing is asked."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies

from sim_backend.receiver.chain import TRAILING_SAMPLES, fast_fft_length, receive, settling_s
from sim_backend.receiver.elements import band_pass, compressed, notch, ringing_s, sampled, switch_gain
from sim_backend.receiver.reception import third_harmonics, widened, with_reception
from sim_backend.receiver.timing import jittered, sampled_with_clock_error
from sim_backend.settings import (
    BandFilter,
    ClockErrors,
    Instruments,
    LogAmplifier,
    ReceiveChain,
    SimulationSettings,
)
from sim_backend.wiring import Bursts, Capture, no_bursts

PERIOD_S = 10e-9
BAND = BandFilter(centre_hz=9.0e6, bandwidth=0.33)
NOTCH = BandFilter(centre_hz=3.0e6, bandwidth=0.5)
FULL = ReceiveChain(preset="paper")


def bursts(onset_ps, length_ps=100_000_000, carrier_hz=3.0e6):
    onset_ps = np.asarray(onset_ps, np.int64)
    same = np.ones(len(onset_ps))
    return Bursts(onset_ps, onset_ps + length_ps, carrier_hz * same, length_ps * 1e-12 * carrier_hz * same, same)


def capture(first_ps=(0,), samples=400):
    return Capture(0, 0, np.asarray(first_ps, np.int64), 10_000, samples)


def echo(samples=1200, centre=900, carrier_hz=9.0e6, amplitude=1.0):
    """A Hann burst of 1.7 us, (1, sample)."""
    time_s = (np.arange(samples) - centre) * PERIOD_S
    envelope = np.where(np.abs(time_s) < 0.85e-6, np.cos(np.pi * time_s / 1.7e-6) ** 2, 0.0)
    return (amplitude * envelope * np.cos(2 * np.pi * carrier_hz * time_s))[None]


@pytest.mark.parametrize("order", [1, 2, 3, 5])
def test_filters_equal_scipys_butterworth(order):
    # here: it takes half a second to load, in every process that collects the tests
    from scipy import signal

    frequency_hz = np.linspace(0.1e6, 50e6, 300)
    for ours, kind, centre_hz, bandwidth in ((band_pass, "bandpass", 9.0e6, 0.33), (notch, "bandstop", 3.0e6, 0.5)):
        half = bandwidth / 2
        edges_hz = centre_hz * (np.sqrt(1 + half**2) + np.array([-half, half]))
        b, a = signal.butter(order, 2 * np.pi * edges_hz / 1e7, kind, analog=True)
        _, expected = signal.freqs(b, a, 2 * np.pi * frequency_hz / 1e7)
        response = ours(BandFilter(centre_hz=centre_hz, bandwidth=bandwidth, order=order), frequency_hz)
        # scipy multiplies the polynomials out: a few digits are lost at order 5.
        assert np.abs(response - expected).max() < 1e-9


def test_filters_pass_and_stop_what_they_should():
    assert band_pass(BAND, np.array([0.0, 9.0e6])) == pytest.approx([0.0, 1.0])
    assert notch(NOTCH, np.array([0.0, 3.0e6])) == pytest.approx([1.0, 0.0])


@settings(max_examples=30, deadline=None)
@given(
    strategies.floats(1e6, 20e6),
    strategies.floats(0.05, 1.5),
    strategies.integers(1, 5),
    strategies.sampled_from([1e-3, 1e-6, 1e-9]),
)
def test_filters_are_causal_and_have_rung_down_when_they_say(centre_hz, bandwidth, order, tolerance):
    """The impulse response is zero before the impulse and below the tolerance of its peak after `ringing_s`."""
    band = BandFilter(centre_hz=centre_hz, bandwidth=bandwidth, order=order)
    tail_s = ringing_s([band], tolerance)
    # Far above the band the response of order 1 falls only like 1/f: what remains at 64 f0 is Gibbs' ripple.
    step_s = 1 / (128 * centre_hz)
    samples = fast_fft_length(int(max(6 * tail_s, 40 / centre_hz) / step_s))
    frequency_hz = np.fft.rfftfreq(samples, step_s)
    smooth = np.exp(-((frequency_hz / (12 * centre_hz)) ** 2))
    impulse = np.fft.irfft(band_pass(band, frequency_hz) * smooth)
    peak = np.abs(impulse).max()
    # The smoothing is a Gaussian of 0.02 / f0; ten of its sigmas count as the instant itself.
    blur = int(np.ceil(0.3 / centre_hz / step_s))
    assert np.abs(impulse[samples // 2 : samples - blur]).max() < max(tolerance, 1e-9) * peak
    late = int(tail_s / step_s) + blur
    assert np.abs(impulse[late : samples - blur]).max() < tolerance * peak


def test_an_empty_chain_changes_nothing():
    volts = np.random.default_rng(1).standard_normal((3, 200))
    assert np.array_equal(receive(volts, ReceiveChain(), PERIOD_S), volts)


def test_linear_chain_is_the_product_of_its_filters_whatever_the_route():
    """One product, or with a switch that passes everything between the two: the same."""
    chain = ReceiveChain(notch=NOTCH, band_pass=BAND)
    volts = np.random.default_rng(2).standard_normal((70, 512))
    one = receive(volts, chain, PERIOD_S)
    apart = receive(volts, chain, PERIOD_S, switch=np.ones_like(volts))
    assert np.abs(one - apart).max() < 1e-13
    frequency_hz = np.fft.rfftfreq(512, PERIOD_S)
    response = sampled(notch(NOTCH, frequency_hz), 1.0) * sampled(band_pass(BAND, frequency_hz), 0.0)
    assert np.abs(one - np.fft.irfft(np.fft.rfft(volts) * response)).max() < 1e-13


def test_samples_before_the_lead_do_not_matter():
    """The chain over a record that begins `settling_s` earlier equals the chain over one from ten times earlier."""
    chain = FULL.model_copy(update={"noise_v_per_sqrt_hz": None})
    rng = np.random.default_rng(3)
    lead = int(np.ceil(settling_s(chain) / PERIOD_S))
    volts = 1e-3 * rng.standard_normal((4, 10 * lead + 300))
    long, short = receive(volts, chain, PERIOD_S), receive(volts[:, 9 * lead :], chain, PERIOD_S)
    wanted = slice(-300 - TRAILING_SAMPLES, -TRAILING_SAMPLES)
    error = np.abs(long[:, wanted] - short[:, wanted]).max()
    # Each of the 22 samples of an e-fold in the tail may hold the largest input, times the gain for small signals.
    gain = chain.log_amplifier.slope_v_per_decade / np.log(10) / (2 * chain.log_amplifier.knee_v)
    assert error < gain * 22 * chain.tail_tolerance * np.abs(volts).max()


def test_logarithm_compresses_eighty_decibels_into_volts_and_saturates():
    amplifier = LogAmplifier(slope_v_per_decade=0.25, knee_v=1e-4, saturation_v=2.0)
    large = compressed(np.array([1e-2, 1e-1, 1.0, 10.0, 1e9, -1e9]), amplifier)
    # asinh(x) = ln(2 x) + 1 / (4 x^2): 2.5e-5 of a neper at the first, whose x is 50.
    assert np.diff(large[:4]) == pytest.approx(0.25, abs=3e-5)
    assert large[4:].tolist() == [2.0, -2.0]
    small = compressed(np.array([1e-9]), amplifier)
    assert small == pytest.approx(1e-9 * 0.25 / np.log(10) / 2e-4, rel=1e-9)


def test_logarithm_between_band_passes_keeps_the_phase_of_the_echo():
    chain = ReceiveChain(band_pass=BAND, log_amplifier=LogAmplifier(), second_band_pass=BAND, oversampling=5)
    linear = ReceiveChain(band_pass=BAND, second_band_pass=BAND)
    fine_s = PERIOD_S / 5
    time_s = (np.arange(4000) - 2500) * fine_s
    envelope = np.where(np.abs(time_s) < 0.85e-6, np.cos(np.pi * time_s / 1.7e-6) ** 2, 0.0)
    volts = np.stack([1e-2 * envelope * np.cos(2 * np.pi * 9e6 * (time_s - late_s)) for late_s in (0.0, 1e-9)])

    def turned(out):
        spectrum = np.fft.rfft(out)
        return np.angle(spectrum[1] * np.conj(spectrum[0]))[np.argmax(np.abs(spectrum[0]))]

    # 1 ns is 56.5 mrad at 9 MHz; the envelope stands still here, so both chains must show the carrier's turn alone.
    # The Hann pulse's image at -9 MHz is (1 / 30)^3 of it: 4e-5 of the turn; the logarithm's harmonics are stopped.
    assert turned(receive(volts, linear, fine_s)) == pytest.approx(-2 * np.pi * 9e6 * 1e-9, rel=1e-4)
    assert turned(receive(volts, chain, fine_s)) == pytest.approx(-2 * np.pi * 9e6 * 1e-9, rel=1e-3)


def test_noise_has_its_density_behind_the_band_pass():
    chain = ReceiveChain(noise_v_per_sqrt_hz=2e-9, band_pass=BAND)
    out = receive(np.zeros((200, 1024)), chain, PERIOD_S, rng=np.random.default_rng(4))
    frequency_hz = np.linspace(0, 50e6, 20001)
    power = np.trapezoid(np.abs(band_pass(BAND, frequency_hz)) ** 2, frequency_hz) * 4e-18
    # Samples are correlated over 1 / (pi B) of 107 ns: 11 samples make one independent one, two of five errors.
    assert np.mean(out**2) == pytest.approx(power, rel=5 * np.sqrt(2 / (out.size / 11)))


def test_switch_shuts_while_something_is_sent_and_opens_with_its_time_constant():
    gain = switch_gain(bursts([1_000_000], length_ps=500_000), capture(samples=400), 1e-6)
    time_s = np.arange(400) * PERIOD_S
    expected = np.where(time_s < 1e-6, 1.0, np.where(time_s < 1.5e-6, 0.0, -np.expm1(-(time_s - 1.5e-6) / 1e-6)))
    assert np.abs(gain[0] - expected).max() < 1e-12


def test_a_switch_without_bursts_is_no_factor():
    sent = bursts([0], length_ps=333_000)
    assert switch_gain(sent, capture(first_ps=(90_000_000,)), 2e-6) is None
    assert switch_gain(no_bursts(), capture(), 2e-6) is None
    assert switch_gain(bursts([50_000_000]), capture(), 2e-6) is None


@pytest.mark.parametrize("samples", [1, 7, 97, 512, 1213, 2049, 5000])
def test_fast_fft_length_has_small_factors_and_is_not_much_longer(samples):
    length = fast_fft_length(samples)
    rest = length
    for factor in (2, 3, 5):
        while rest % factor == 0:
            rest //= factor
    assert rest == 1
    assert samples <= length <= samples * 1.15 + 1


def test_jitter_has_its_rms_and_belongs_to_the_burst():
    onset_ps = np.arange(20_000) * 250_000_000
    moved = jittered(bursts(onset_ps), 1e-9, seed=5)
    move_s = (moved.onset_ps - onset_ps) * 1e-12
    # Five standard errors of 20000 draws: rms 1/sqrt(2n), mean 1/sqrt(n), neighbours' correlation 1/sqrt(n).
    assert move_s.std() == pytest.approx(1e-9, rel=5 / np.sqrt(40_000))
    assert abs(move_s.mean()) < 5e-9 / np.sqrt(20_000)
    assert abs(np.corrcoef(move_s[1:], move_s[:-1])[0, 1]) < 5 / np.sqrt(20_000)
    assert np.array_equal(moved.end_ps - moved.onset_ps, np.full(20_000, 100_000_000))
    some = jittered(bursts(onset_ps[::-7]), 1e-9, seed=5)
    assert np.array_equal(some.onset_ps, moved.onset_ps[::-7])
    assert not np.array_equal(jittered(bursts(onset_ps), 1e-9, seed=6).onset_ps, moved.onset_ps)


def test_jitter_follows_the_capture_and_not_the_hour():
    """A run that goes on later draws what it would have drawn; the next capture draws anew."""
    early, late = np.arange(50) * 250_000_000, np.arange(50) * 250_000_000 + 10**15
    moves = [
        jittered(bursts(onset_ps), 1e-9, 5, origin_ps=int(onset_ps[0]), index=index).onset_ps - onset_ps
        for onset_ps, index in ((early, 3), (late, 3), (early, 4))
    ]
    assert np.array_equal(moves[0], moves[1])
    assert not np.array_equal(moves[0], moves[2])


class _Sent:
    """Physics that keeps what was transmitted."""

    def record_volts(self, tonebursts, pulses, capture):
        self.tonebursts, self.pulses = tonebursts, pulses
        return np.zeros((1, capture.samples))

    def focus_displacement_m(self, tonebursts, time_ps, origin_ps, *, index=0):
        self.moving = tonebursts
        return np.zeros(len(time_ps))


def test_one_generator_shakes_a_pulse_and_two_in_a_row_a_toneburst():
    onset_ps, sent = np.arange(20_000) * 250_000_000, _Sent()
    physics = with_reception(sent, SimulationSettings(instruments=Instruments(trigger_jitter_s=1e-9)))
    physics.record_volts(bursts(onset_ps), bursts(onset_ps, 300_000, 9e6), capture())
    physics.focus_displacement_m(bursts(onset_ps), onset_ps, 0)
    pushed_s, tracked_s = ((each.onset_ps - onset_ps) * 1e-12 for each in (sent.tonebursts, sent.pulses))
    # Five standard errors of 20000 draws, as above.
    assert tracked_s.std() == pytest.approx(1e-9, rel=5 / np.sqrt(40_000))
    assert pushed_s.std() == pytest.approx(np.sqrt(2) * 1e-9, rel=5 / np.sqrt(40_000))
    assert abs(np.corrcoef(pushed_s, tracked_s)[0, 1]) < 5 / np.sqrt(20_000)
    # What moves the focus is what was heard.
    assert np.array_equal(sent.moving.onset_ps, sent.tonebursts.onset_ps)


def test_no_jitter_returns_the_bursts_themselves():
    one = bursts([0, 1])
    assert jittered(one, 0.0, seed=1) is one


def test_slow_clock_samples_later_and_later():
    volts = np.sin(2 * np.pi * 9e6 * np.arange(2060) * PERIOD_S)[None]
    clock = Instruments(clock_error=ClockErrors(digitizer=-1e-5 / (1 + 1e-5)))
    out = sampled_with_clock_error(volts, slice(6, 2054), PERIOD_S, clock, np.random.default_rng(6))
    late_s = np.arange(2048) * PERIOD_S * 1e-5
    expected = np.sin(2 * np.pi * 9e6 * (np.arange(6, 2054) * PERIOD_S + late_s))
    # First order in w t = 0.0116 rad: (w t)^2 / 2 = 7e-5; the stencil's slope is 2e-4 of w t off.
    assert np.abs(out - expected).max() < 8e-5


def test_aperture_jitter_is_noise_of_the_slope():
    volts = np.sin(2 * np.pi * 9e6 * np.arange(20_012) * PERIOD_S)[None]
    clock = Instruments(sample_clock_jitter_s=10e-12)
    out = sampled_with_clock_error(volts, slice(6, 20_006), PERIOD_S, clock, np.random.default_rng(7))
    noise = out - volts[:, 6:20_006]
    assert noise.std() == pytest.approx(2 * np.pi * 9e6 * 10e-12 / np.sqrt(2), rel=5 * np.sqrt(1.5 / 20_000))


class Recorded:
    """A physics that gives a carrier at every instant, whatever is sent."""

    def record_volts(self, tonebursts, pulses, what):
        time_s = (what.first_sample_ps[:, None] + np.arange(what.samples) * what.sample_period_ps) * 1e-12
        return 1e-3 * np.sin(2 * np.pi * 9e6 * time_s)

    def focus_displacement_m(self, tonebursts, time_ps, origin_ps, *, index=0):
        return np.zeros(len(time_ps))


def test_without_reception_settings_the_acoustics_are_unchanged():
    acoustics = Recorded()
    assert with_reception(acoustics, SimulationSettings()) is acoustics


@pytest.mark.parametrize("oversampling", [1, 2, 5])
def test_the_output_has_the_samples_of_the_capture(oversampling):
    """A band-pass leaves its centre frequency alone, so the carrier comes out where it went in."""
    chain = ReceiveChain(band_pass=BandFilter(centre_hz=9.0e6, bandwidth=0.33), oversampling=oversampling)
    what = capture(first_ps=(90_000_000, 340_000_000))
    received = with_reception(Recorded(), SimulationSettings(receive_chain=chain))
    out = received.record_volts(no_bursts(), no_bursts(), what)
    expected = Recorded().record_volts(None, None, what)
    # The carrier does not fit the widened record: its ends ring. Backwards only as far as the filter's response at
    # half the sampling rate, 0.35 %, rings under its taper: (4 x 20 MHz x 24 samples of 10 ns)^-3 = 1e-4 of it.
    assert np.abs(out - expected).max() < (4e-7 + 22 * chain.tail_tolerance) * 1e-3


def test_widened_capture_holds_the_wanted_one():
    chain = FULL.model_copy(update={"oversampling": 2})
    settings_ = SimulationSettings(receive_chain=chain, instruments=Instruments(sample_clock_jitter_s=1e-12))
    what = capture(first_ps=(90_000_000,), samples=512)
    wide, kept = widened(settings_, what)
    assert wide.first_sample_ps[0] + kept.start * wide.sample_period_ps == 90_000_000
    assert len(range(*kept.indices(wide.samples))) == 512
    assert kept.step * wide.sample_period_ps == 10_000
    assert kept.start * wide.sample_period_ps * 1e-12 >= settling_s(chain)
    assert wide.samples - kept.stop >= 3 + TRAILING_SAMPLES


def test_third_harmonics_have_three_times_the_carrier_and_the_stated_amplitude():
    assert third_harmonics(bursts([0]), 0.0).onset_ps.size == 0
    third = third_harmonics(bursts([0]), 0.02)
    assert (third.carrier_hz[0], third.amplitude_vpp[0]) == (9.0e6, pytest.approx(0.02))


def test_chain_and_snr_together_are_refused():
    with pytest.raises(ValueError, match="exclude each other"):
        SimulationSettings.model_validate({"receive_chain": {}, "receiver": {"snr_db": 40.0}})


def test_preset_fills_in_what_is_absent_and_leaves_what_is_said():
    chain = ReceiveChain.model_validate({"preset": "paper", "band_pass": {"centre_hz": 8.0e6, "bandwidth": 0.2}})
    assert chain.band_pass.centre_hz == 8.0e6
    assert chain.notch.bandwidth == 0.5
    assert chain.log_amplifier is not None
    assert ReceiveChain().log_amplifier is None
