"""Print what is left of the true harmonics when shifting pulses sample the true motion, delay by delay.

Neither noise nor echoes take part: what differs is what the skipped pulses leave undetermined.

Usage: python scripts/shifting_pulses.py [SCENE [DELAY_US ...]]
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import h5py
import numpy as np
from numpy.typing import NDArray

from hpe_rig.estimation import driven_frequencies_hz
from hpe_rig.interference import disturbed_pulses
from hpe_rig.run import Setup, measure, prepare, prepare_text
from hpe_rig.scene import scene_text
from hpe_rig.store_layout import TRUE_HARMONICS


def main(scene: str = "bovine-muscle", *delays_us: str) -> None:
    """Print the largest errors over the wanted frequencies for each delay, by default around the scene's own."""
    name, text = scene_text(scene)
    own_s = prepare(scene).scene.scene.tracking.delay_s
    tried_s = [float(delay) * 1e-6 for delay in delays_us] or [own_s + step * 1e-6 for step in (-1, 0, 1, 5, 10)]
    print("delay (us)  amplitude (%)  phase (degrees), largest of the wanted frequencies")
    for delay_s in tried_s:
        lines = [f"delay_s = {delay_s!r}" if line.startswith("delay_s") else line for line in text.splitlines()]
        ratio = left_of_truth(prepare_text(name, "\n".join(lines)))
        amplitude, phase = np.abs(np.abs(ratio) - 1).max() * 100, np.degrees(np.abs(np.angle(ratio)).max())
        print(f"{delay_s * 1e6:10.1f}  {amplitude:13.2f}  {phase:15.2f}")


def left_of_truth(setup: Setup) -> NDArray[np.complex128]:
    """Return the fitted over the true harmonic (frequency,) of the twin's true motion at the pulses that are used."""
    scene, shot = setup.scene.scene, setup.plan.shots[0]
    with TemporaryDirectory() as folder, h5py.File(measure(setup, Path(folder) / "run.h5")) as file:
        motion_m = file["truth/displacement_m"][0]
        in_phase_m, quadrature_m = (file[f"true_harmonics/{part}"][0] for part in TRUE_HARMONICS)
    used = ~disturbed_pulses(shot) & np.isfinite(motion_m)
    used &= shot.timeline.pulse_onset_s >= scene.processing.window_start_s
    time_s = shot.timeline.pulse_onset_s[used] - shot.timeline.burst_onset_s[0]
    wanted_hz = np.array(scene.wanted_frequencies_hz)
    angle = 2 * np.pi * np.outer(time_s, np.union1d(wanted_hz, driven_frequencies_hz(scene)))
    matrix = np.hstack([np.sin(angle), np.cos(angle), np.ones((time_s.size, 1))])
    sine, cosine = np.linalg.lstsq(matrix, motion_m[used], rcond=None)[0][:-1].reshape(2, -1)
    place = np.searchsorted(np.union1d(wanted_hz, driven_frequencies_hz(scene)), wanted_hz)
    ratio: NDArray[np.complex128] = (sine + 1j * cosine)[place] / (in_phase_m + 1j * quadrature_m)
    return ratio


if __name__ == "__main__":
    main(*sys.argv[1:])
