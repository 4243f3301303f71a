"""A capture computed block by block has the same volts, in any order of blocks."""

import numpy as np
import pytest

from sim_backend.acoustics.acoustics import Acoustics
from sim_backend.digitizer import recording
from sim_backend.digitizer.board import AcceptedTriggers, Arming, BoardSettings
from sim_backend.digitizer.capture_snapshot import CaptureSnapshot
from sim_backend.digitizer.recording import Recording
from sim_backend.receiver.reception import with_reception
from sim_backend.settings import BandFilter, Instruments, MotionComponent, ReceiveChain, Receiver, SimulationSettings
from sim_backend.wiring import Bursts, no_bursts

RECORDS, SAMPLES = 50, 256
MOTION = (MotionComponent(frequency_hz=200.0, amplitude_m=1e-6),)
NOISY = SimulationSettings(motion=MOTION, receiver=Receiver(snr_db=20.0))
EVERYTHING = SimulationSettings(
    motion=MOTION,
    receive_chain=ReceiveChain(
        band_pass=BandFilter(centre_hz=9e6, bandwidth=0.33), noise_v_per_sqrt_hz=1e-6, oversampling=2
    ),
    instruments=Instruments(trigger_jitter_s=1e-10, sample_clock_jitter_s=1e-11),
)


def snapshot(records=RECORDS, amplitude_vpp=1.0):
    onset_ps = 10**9 + np.arange(records, dtype=np.int64) * 250_000_000
    ones = np.ones(records)
    pulses = Bursts(onset_ps, onset_ps + 333_333, 9e6 * ones, 3 * ones, amplitude_vpp * ones)
    first_ps = onset_ps + 89_600_000
    triggers = AcceptedTriggers(
        onset_ps, first_ps, first_ps + SAMPLES * 10_000, np.ones(records, np.int64), 0, onset_ps
    )
    arming = Arming(0, 0, BoardSettings(post_samples=SAMPLES, record_count=records))
    return CaptureSnapshot(arming, triggers, no_bursts(), pulses, 0)


def volts_of_whole_capture(settings, captured):
    physics = with_reception(Acoustics(settings), settings)
    return physics.record_volts(captured.tonebursts, captured.pulses, captured.capture)


@pytest.fixture
def blocks_of_eight(monkeypatch):
    monkeypatch.setattr(recording, "BLOCK_VALUES", 8 * SAMPLES)
    monkeypatch.setattr(recording, "CACHED_BLOCKS", 2)


@pytest.mark.parametrize("settings", [NOISY, EVERYTHING], ids=["noise", "chain, jitter and clock"])
def test_blocks_hold_the_volts_of_the_whole_capture(settings, blocks_of_eight):
    captured, expected = snapshot(), volts_of_whole_capture(settings, snapshot())
    blocks = Recording(with_reception(Acoustics(settings), settings).record_volts)
    blocks.update(captured, 0)
    # Forwards, back to blocks that left the cache, then across blocks. Noise is equal; echoes to 1e-8.
    for records in (slice(0, 20), slice(20, 50), slice(3, 4), slice(47, 50), slice(5, 29)):
        error = np.abs(blocks.volts(records) - expected[records]).max()
        assert error < 2e-7 * np.abs(expected).max()


def test_the_peak_voltage_is_the_running_maximum_of_the_records(blocks_of_eight):
    expected = np.abs(volts_of_whole_capture(NOISY, snapshot())).max(axis=1)
    blocks = Recording(Acoustics(NOISY).record_volts)
    blocks.update(snapshot(), 0)
    assert blocks.peak_v(0) == 0.0
    for count in (50, 1, 8, 9, 33):
        assert blocks.peak_v(count) == pytest.approx(expected[:count].max(), rel=1e-6)


def test_complete_records_stay_when_the_remaining_ones_change(blocks_of_eight):
    before, after = snapshot(), snapshot(amplitude_vpp=2.0)
    blocks = Recording(Acoustics(NOISY).record_volts)
    blocks.update(before, int(before.triggers.end_ps[19]))
    peak_v = blocks.peak_v(20)
    blocks.update(after, int(after.triggers.end_ps[30]))
    expected = np.concatenate([volts_of_whole_capture(NOISY, before)[:20], volts_of_whole_capture(NOISY, after)[20:]])
    assert np.abs(blocks.volts(slice(0, 50)) - expected).max() < 2e-7 * np.abs(expected).max()
    assert blocks.peak_v(20) == peak_v
    assert blocks.peak_v(50) == pytest.approx(np.abs(expected).max(), rel=1e-6)


def test_a_block_uses_only_the_pulses_near_it(blocks_of_eight):
    calls = []

    def record_volts(tonebursts, pulses, capture):
        calls.append((len(pulses.onset_ps), capture.first_record, len(capture.first_sample_ps)))
        return np.zeros((len(capture.first_sample_ps), capture.samples))

    blocks = Recording(record_volts)
    blocks.update(snapshot(1000), 0)
    blocks.volts(slice(500, 508))
    # Records 496 to 503 and 504 to 511, and pulses up to 10 ms, 40 periods, before and after them.
    assert [call[1:] for call in calls] == [(496, 8), (504, 8)]
    assert all(8 + 2 * 39 <= pulses <= 8 + 2 * 42 for pulses, _, _ in calls)
