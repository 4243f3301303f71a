"""Print the aliasing error of the wanted harmonics for several delays; ``hpe-rig check`` prints it for one.

Usage: python scripts/validation/shifting_pulses.py [SCENE [DELAY_US ...]]
"""

import argparse
import sys

import numpy as np

from hpe_rig.measurement import prepare, prepare_text
from hpe_rig.prediction import fitted_over_true
from hpe_rig.scene import scene_text


def main() -> None:
    """Print the largest errors over the wanted frequencies for each delay, by default around that of the scene."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("scene", nargs="?", default="bovine-muscle", help="a shipped scene's name or a TOML file")
    parser.add_argument("delays_us", nargs="*", type=float, metavar="DELAY_US", help="delays t_d of the tracking train")
    arguments = parser.parse_args()
    name, text = scene_text(arguments.scene)
    scene_delay_s = prepare(arguments.scene).scene.scene.tracking.delay_s
    steps_us = (-1, 0, 1, 5, 10)
    delays_s = [delay * 1e-6 for delay in arguments.delays_us] or [scene_delay_s + step * 1e-6 for step in steps_us]
    print("delay (us)  amplitude (%)  phase (degrees), largest of the wanted frequencies")
    for delay_s in delays_s:
        lines = [f"delay_s = {delay_s!r}" if line.startswith("delay_s") else line for line in text.splitlines()]
        setup = prepare_text(name, "\n".join(lines))
        ratio = fitted_over_true(setup.scene.scene, setup.plan.shots[0])
        if ratio is None:
            sys.exit(f"{name}: aliasing is predicted only for a known medium and multiples of the burst rate")
        amplitude, phase = np.abs(np.abs(ratio) - 1).max() * 100, np.degrees(np.abs(np.angle(ratio)).max())
        print(f"{delay_s * 1e6:10.1f}  {amplitude:13.2f}  {phase:15.2f}")


if __name__ == "__main__":
    main()
