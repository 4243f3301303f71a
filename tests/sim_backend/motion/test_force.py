"""Radiation force pulses against eq. (17) and (18)."""

import numpy as np
import pytest

from sim_backend.motion.force import radiation_force, transmit_response
from sim_backend.settings import Specimen
from sim_backend.wiring import Bursts


def bursts(onset_ps, *, carrier_hz=3.0e6, cycles=300.0, amplitude_vpp=1.0, duration_ps=100_000_000):
    onset_ps = np.asarray(onset_ps, dtype=np.int64)
    count = len(onset_ps)
    return Bursts(
        onset_ps,
        onset_ps + duration_ps,
        np.full(count, carrier_hz),
        np.full(count, cycles),
        np.full(count, amplitude_vpp),
    )


def test_force_pulse_begins_when_the_burst_reaches_the_focus_and_lasts_as_long():
    force = radiation_force(bursts([0, 10_000_000_000]), Specimen(), 45.5e-6)
    assert force.onset_ps.tolist() == [45_500_000, 10_045_500_000]
    assert force.end_ps.tolist() == [145_500_000, 10_145_500_000]
    assert force.force_density_n_per_m3 == pytest.approx([4.0e6, 4.0e6])


def test_burst_cut_short_gives_a_shorter_pulse_of_the_same_height():
    force = radiation_force(bursts([0], duration_ps=40_000_000), Specimen(), 0.0)
    assert force.end_ps[0] - force.onset_ps[0] == 40_000_000
    assert force.force_density_n_per_m3[0] == pytest.approx(4.0e6)


def test_a_warming_specimen_answers_later_bursts_more_strongly_and_later():
    """20 % and 300 us per second: at the third burst, 0.2 s after the first, 4 % and 60 us."""
    specimen = Specimen(growth_per_s=0.2, delay_growth_s_per_s=300e-6)
    force = radiation_force(bursts([10**12, 1_100_000_000_000, 1_200_000_000_000]), specimen, 45.5e-6)
    assert (force.onset_ps - 45_500_000).tolist() == [10**12, 1_100_030_000_000, 1_200_060_000_000]
    assert (force.end_ps - force.onset_ps).tolist() == [100_000_000] * 3
    assert force.force_density_n_per_m3 == pytest.approx([4.0e6, 4.08e6, 4.16e6], rel=1e-14)


@pytest.mark.parametrize("drive_vpp", [0.1, 0.5, 2.0])
def test_force_goes_with_the_square_of_the_drive(drive_vpp):
    force = radiation_force(bursts([0], amplitude_vpp=drive_vpp), Specimen(reference_drive_vpp=0.5), 0.0)
    assert force.force_density_n_per_m3[0] == pytest.approx(4.0e6 * (drive_vpp / 0.5) ** 2, rel=1e-14)


def test_wrong_carrier_gives_less_force():
    at_9_mhz = radiation_force(bursts([0], carrier_hz=9.0e6), Specimen(), 0.0)
    assert at_9_mhz.force_density_n_per_m3[0] == pytest.approx(4.0e6 * 10**-1.6, rel=5e-3)


def test_transducer_responds_16_db_less_at_9_mhz_than_at_its_resonance():
    quality = Specimen().resonance_quality
    response = transmit_response(np.array([1.0e6, 3.0e6, 9.0e6]), 3.0e6, quality)
    # 2.34 is rounded to three digits: 0.02 dB.
    assert 20 * np.log10(response[2]) == pytest.approx(-16.0, abs=0.02)
    assert response[1] == 1.0
    assert response[0] == pytest.approx(response[2])


def test_harmonics_of_the_force_train_follow_eq_18():
    """Fourier integral over one period of the pulse that comes out, against the printed spectrum."""
    rate_hz, burst_s = 100.0, 100e-6
    force = radiation_force(bursts([0]), Specimen(), 0.0)
    n = np.arange(1, 120)
    begin_s, end_s = force.onset_ps[0] * 1e-12, force.end_ps[0] * 1e-12
    omega = 2 * np.pi * n * rate_hz
    integral = (np.exp(-1j * omega * begin_s) - np.exp(-1j * omega * end_s)) / (1j * omega)
    ours = rate_hz * force.force_density_n_per_m3[0] * integral
    x = n * rate_hz * burst_s
    eq_18 = 4.0e6 * rate_hz * burst_s * np.sinc(x) * np.exp(-1j * np.pi * x)
    assert np.abs(ours - eq_18).max() < 1e-11 * np.abs(eq_18).max()
    assert np.abs(ours[99]) < 1e-11 * np.abs(eq_18).max()
