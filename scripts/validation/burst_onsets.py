"""Print how many onsets of tonebursts lie within the records of each shipped scene.

Usage: python scripts/validation/burst_onsets.py
"""

import argparse

import numpy as np

import hpe_rig as hpe
from hpe_rig.bench import read_bench
from hpe_rig.plan import Timeline, make_plan
from hpe_rig.scene import shipped_scenes


def onsets_in_records(line: Timeline) -> tuple[int, int]:
    """Return the number of tonebursts whose onset a record contains, and the number of all tonebursts of a shot."""
    start_s, end_s = (line.pulse_onset_s + offset_s for offset_s in line.record_offset_s)
    record = np.searchsorted(start_s, line.burst_onset_s) - 1
    inside = (record >= 0) & (line.burst_onset_s < end_s[np.maximum(record, 0)])
    return int(inside.sum()), inside.size


def main() -> None:
    """Print a line for each scene with tonebursts."""
    argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0]).parse_args()
    bench = read_bench().bench
    for name in shipped_scenes():
        scene = hpe.load_scene(name)
        if scene.excitation is None:
            continue
        counts = [onsets_in_records(shot.timeline) for shot in make_plan(scene, bench).shots]
        recorded, bursts = np.sum(counts, axis=0)
        print(f"{name:28}{recorded} of {bursts}")


if __name__ == "__main__":
    main()
