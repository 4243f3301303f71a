"""I and Q become the real samples that a sampler at the carrier would have recorded."""

from __future__ import annotations

import numpy as np
import pytest

from hpe_rig.recordings.carrier import to_radio_frequency

RATE_HZ, CARRIER_HZ, SAMPLES = 10e6, 5e6, 400


@pytest.mark.parametrize("offset_hz", [-4e6, -1.3e6, 0.0, 2.1e6, 4e6])
def test_a_tone_keeps_amplitude_and_phase(offset_hz: float) -> None:
    time_s = np.arange(SAMPLES) / RATE_HZ
    tone = np.exp(1j * (2 * np.pi * offset_hz * time_s + 0.3))
    samples, rate_hz = to_radio_frequency(tone, RATE_HZ, CARRIER_HZ, CARRIER_HZ)
    fine_s = np.arange(samples.size) / rate_hz
    expected = np.cos(2 * np.pi * (CARRIER_HZ + offset_hz) * fine_s + 0.3)
    # At the ends the filter reaches out of the record. Images are 100 dB below the tone, float32 resolves 6e-8.
    inside = slice(samples.size // 5, -samples.size // 5)
    np.testing.assert_allclose(samples[inside], expected[inside], atol=3e-5)
