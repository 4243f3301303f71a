"""Measure the anonymous memory of an import of raw values, shot by shot, beyond that of the program. Linux.

Pages of the file itself, which the system takes back at any time, are not in it.

    python scripts/benchmarks/import_memory.py [--gigabytes 2]
"""

from __future__ import annotations

import argparse
import tempfile
import threading
from pathlib import Path

import numpy as np

from hpe_rig.runs import import_recording

RATES = {"sample_rate_hz": 40e6, "pulse_rate_hz": 4e3, "carrier_hz": 9e6}
SCENE = 'title = "Import"\n[tracking]\n[acquisition]\ngate_depth_m = 5e-3\ngate_length_m = 1e-3\nrepeats = {}\n'
SHOT = (500, 2000)


def anonymous_mb() -> float:
    """Return the anonymous memory of this process."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return next(float(line.split()[1]) / 1e3 for line in lines if line.startswith("RssAnon"))


def memory_text(gigabytes: float, folder: Path) -> str:
    """Import a file of raw values and return the memory that it took."""
    recording, scene = folder / "long.raw", folder / "scene.toml"
    shot = (1000 * np.random.default_rng(1).normal(size=SHOT)).astype("<i2")
    shots = max(1, round(gigabytes * 1e9 / shot.nbytes))
    with recording.open("wb") as file:
        for _ in range(shots):
            file.write(shot.tobytes())
    scene.write_text(SCENE.format(shots) + "[processing]\nfrequencies_hz = [200.0]\n", encoding="utf-8")
    settings = RATES | {"dtype": "int16", "shape": (shots, *SHOT), "axes": "shot,pulse,sample"}
    before_mb, peak_mb, done = anonymous_mb(), [0.0], threading.Event()

    def watch() -> None:
        """Measure the memory until the import is done."""
        while not done.wait(0.005):
            peak_mb[0] = max(peak_mb[0], anonymous_mb())

    thread = threading.Thread(target=watch)
    thread.start()
    import_recording(recording, str(scene), folder / "long.h5", None, settings)
    done.set()
    thread.join()
    return (
        f"{recording.stat().st_size / 1e9:.3g} GB of raw values in shots of {shot.nbytes / 1e6:.3g} MB: "
        f"{peak_mb[0] - before_mb:.0f} MB"
    )


def main() -> None:
    """Print the memory."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gigabytes", type=float, default=0.2)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        print(memory_text(arguments.gigabytes, Path(folder)))


if __name__ == "__main__":
    main()
