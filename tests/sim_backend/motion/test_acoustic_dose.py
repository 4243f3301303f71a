"""Acoustic output relative to its limits against the figures of the theory."""

import numpy as np
import pytest

from sim_backend.motion.acoustic_dose import dose
from sim_backend.settings import Specimen


def test_displacement_at_the_limit_is_that_of_the_theory():
    """docs/explanation/medium.md, 6: 1 % duty, 4 kPa, column of 0.34 mm: 72 W/cm^2, 16.1 kN/m^3, 18.7 nm at 200 Hz."""
    column_m = (0.34e-3, 0.34e-3, 1.0)
    what = dose(Specimen(preset="gelatin_8"), column_m, 100.0, 100e-6, np.array([200.0]), 1540.0)
    assert what.limit_w_per_m2 == pytest.approx(72e4)
    assert what.force_limit_n_per_m3 == pytest.approx(16.1e3, rel=5e-3)
    assert what.displacement_limit_m[0] == pytest.approx(18.7e-9, rel=5e-3)


def test_short_tonebursts_are_limited_by_their_own_intensity_and_long_ones_by_the_mean():
    """FDA track 3: 190 W/cm^2 while on, 720 mW/cm^2 on average; equal at a duty of 0.72 / 190."""
    limits = [
        dose(Specimen(), (0.17e-3, 0.17e-3, 1.8e-3), 100.0, length_s, np.array([200.0]), 1540.0).limit_w_per_m2
        for length_s in (10e-6, 37e-6, 39e-6)
    ]
    assert limits == pytest.approx([190e4, 190e4, 0.72e4 / 39e-4])


def test_intensity_over_the_limit_is_two_attenuations_over_the_sound_speed():
    """5 MN/m^3 in 0.5 dB/cm/MHz: 17.27 Np/m at 3 MHz, 22.3 kW/cm^2, 310 times 72 W/cm^2."""
    specimen = Specimen(attenuation_db_per_cm_mhz=0.5, force_density_n_per_m3=5e6)
    what = dose(specimen, (0.17e-3, 0.17e-3, 1.8e-3), 100.0, 100e-6, np.array([200.0]), 1540.0)
    assert what.intensity_w_per_m2 / what.limit_w_per_m2 == pytest.approx(309.6, rel=1e-3)
