"""The paper's bovine muscle on the twin: the floor that jitter and noise set, and slopes against toneburst length."""

import re

import numpy as np
import pytest

from hpe_rig.measurement.run import record_run
from hpe_rig.measurement.setup import prepare_text
from hpe_rig.prediction.detection import detection_floor
from hpe_rig.report.sweep import fit_line
from hpe_rig.runs.run import process
from hpe_rig.scene import shipped_scenes

SCENES = shipped_scenes()
REPEATS = 8
pytestmark = pytest.mark.slow


def edited(name, *edits):
    text = SCENES[name]
    for pattern, new in edits:
        assert re.search(pattern, text), pattern
        text = re.sub(pattern, new, text)
    return text


@pytest.mark.parametrize(
    ("name", "edits"),
    [
        ("muscle-repeats", ()),
        ("muscle-repeats", (("trigger_jitter_s = 1.0e-9", "trigger_jitter_s = 3.0e-9"),)),
        ("muscle-repeats", (("window_length_s = 100e-3", "window_length_s = 50e-3"),)),
        ("muscle-repeats", (("pulse_rate_hz = 4000.0", "pulse_rate_hz = 2500.0"),)),
        ("bovine-muscle-synchronous", (("snr_db = 40.0", "snr_db = 20.0"),)),
        ("bovine-muscle-synchronous", (("snr_db = 40.0", "snr_db = 10.0"),)),
    ],
)
def test_amplitudes_of_nothing_are_those_of_the_stated_jitter_and_noise(tmp_path, name, edits):
    """A ten-thousandth of the force moves less than 0.1 nm: what is left is the floor, and it moves as theory says."""
    repeats = (r"gate_length_m = 1.0e-3\n(repeats = 5\n)?", f"gate_length_m = 1.0e-3\nrepeats = {REPEATS}\n")
    force = (r"(force_fraction = .*\n)?\n\[tracking\]", "force_fraction = 1e-4\n\n[tracking]")
    # A prior shrinks what is noise alone: its amplitudes stay below the floor even more often.
    plain = (r"\[processing\]\n", '[processing]\nharmonic = "least_squares"\n')
    setup = prepare_text("a", edited(name, *edits, repeats, force, plain))
    shots = process(record_run(setup, tmp_path / "a.h5")).shots
    amplitude_m = np.array([[item.tracked_amplitude_m for item in shot.estimates] for shot in shots])
    expected_m = detection_floor(setup.scene.scene, True, setup.plan.shots[0]).quadrature_m
    # Two quadratures each: the root of their mean square is known to 1 / sqrt(4 n); three of it. Speckle makes the
    # echo's power, and so its SNR, differ from the mean over places by as much as 10 % in this one.
    share = 3 / np.sqrt(4 * amplitude_m.size) + (0.1 if "snr" in str(edits) else 0.0)
    assert np.sqrt(np.mean(amplitude_m**2) / 2) / expected_m == pytest.approx(1.0, abs=share)
    # Rayleigh's law: one in twenty beyond the floor.
    beyond = np.mean(amplitude_m > detection_floor(setup.scene.scene, True, setup.plan.shots[0]).detected_m)
    assert beyond <= 0.05 + 3 * np.sqrt(0.05 * 0.95 / amplitude_m.size)


def test_slopes_double_with_the_toneburst_length_and_lines_are_straight(tmp_path):
    """Fig. 15: 409, 812 and 1654 nm per F_0 in the paper. Five forces, five repeats each."""
    lines = {}
    few = (r"force_fraction = .*", "force_fraction = [1.0, 0.81, 0.64, 0.49, 0.36]")
    for name in ("muscle-force", "muscle-force-200us"):
        shots = process(record_run(prepare_text(name, edited(name, few)), tmp_path / f"{name}.h5")).shots
        for length_s in {shot.burst_length_s for shot in shots}:
            own = [shot for shot in shots if shot.burst_length_s == length_s]
            force = np.array(sorted({shot.force_fraction for shot in own}))
            each_m = [[s.estimates[1].tracked_amplitude_m for s in own if s.force_fraction == f] for f in force]
            nm = np.mean(each_m, axis=1) * 1e9
            lines[round(length_s * 1e6)] = fit_line(force, nm)
    for over, under in ((100, 50), (200, 100), (200, 50)):
        ratio = lines[over].slope / lines[under].slope
        u = ratio * np.hypot(lines[over].slope_u / lines[over].slope, lines[under].slope_u / lines[under].slope)
        # Three degrees of freedom in each error: two of them are 0.9 of all cases.
        assert abs(ratio - over / under) < 2 * u
    assert min(line.r_squared for line in lines.values()) > 0.9
    assert lines[100].slope == pytest.approx(812, abs=3 * lines[100].slope_u)
