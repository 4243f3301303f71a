"""The spectra show the mean over repeats of the setting that moves most, and a selected shot alone."""

from __future__ import annotations

import pytest

from hpe_rig.result import Estimate, Result, ShotResult, main_shot, means_of, probability_text, spectrum_pictures


def shot(index: int, repeat: int, force_fraction: float, amplitude_m: float) -> ShotResult:
    estimate = Estimate(200.0, amplitude_m, 1e-9, 0.5, 1e-3)
    return ShotResult(index, repeat, 1e-4, force_fraction, 100, 0, 1e-9, (estimate,), ())


# The largest shot is in the setting with the smaller mean.
SHOTS = (shot(0, 0, 0.5, 110e-9), shot(1, 0, 1.0, 99e-9), shot(2, 1, 0.5, 80e-9), shot(3, 1, 1.0, 101e-9))
RESULT = Result("t", "t.h5", True, "complete", "coherent", "burst", SHOTS, (), (), {}, {})


def test_the_setting_with_the_largest_mean_is_drawn_by_its_mean() -> None:
    main = main_shot(RESULT)
    assert main.force_fraction == 1.0
    assert [mean.shots for mean in means_of(RESULT.means, main)] == [(2, 4)]
    amplitude, phase = spectrum_pictures(RESULT, main)
    assert "Amplitude in nm: 100 at 200 Hz" in amplitude.alt
    assert "Phase in degrees: 28.65 at 200 Hz" in phase.alt


def test_a_selected_shot_is_drawn_alone() -> None:
    assert "Amplitude in nm: 80 at 200 Hz" in spectrum_pictures(RESULT, SHOTS[2], alone=True)[0].alt


@pytest.mark.parametrize(("value", "text"), [(0.0, "< 1e-16"), (2e-17, "< 1e-16"), (0.0312, "0.031"), (1.0, "1")])
def test_a_probability_below_double_precision_is_a_bound(value: float, text: str) -> None:
    assert probability_text(value) == text
