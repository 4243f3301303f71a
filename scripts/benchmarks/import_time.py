"""Time to open and read a recording, compared with the plain call of the library, and the memory of an import.

Each file holds the same 25 MB of echoes (or as text 3 MB). Columns: shortest time of the plain call, of the plain call
and the SHA-256 of the file, and of the import's reading, with checks and checksum; then median ratios of the same
round. The last line is the anonymous memory of an import of raw values, shot by shot, beyond that of the program (Linux
alone). Pages of the file itself, which the system takes back at any time, are not in it.

    python scripts/benchmarks/import_time.py [--rounds 9] [--gigabytes 2]
"""

from __future__ import annotations

import argparse
import hashlib
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from scipy.io import loadmat, savemat

from hpe_rig.recordings import read_recording, read_settings
from hpe_rig.result import text_table
from hpe_rig.runs import import_recording

LINES, PULSES, SAMPLES, TEXT_PULSES = 25, 100, 2560, 20
RATES = {"sample_rate_hz": 40e6, "pulse_rate_hz": 4e3, "carrier_hz": 9e6}
SCENE = 'title = "Import"\n[tracking]\n[acquisition]\ngate_depth_m = 5e-3\ngate_length_m = 1e-3\nrepeats = {}\n'
SHOT = (500, 2000)


def plain_hdf5(path: Path) -> Any:
    """Return the dataset of the file."""
    with h5py.File(path) as file:
        return file["rf"][()]


def files(folder: Path) -> dict[str, tuple[Path, Callable[[Path], Any], dict[str, Any]]]:
    """Write one file of each format; return them with the plain call that reads them and the settings they lack."""
    rf = np.random.default_rng(1).normal(size=(LINES, PULSES, SAMPLES)).astype(np.float32)
    np.save(folder / "rf.npy", rf)
    np.savez(folder / "rf.npz", rf=rf)
    rf.tofile(folder / "rf.raw")
    savemat(folder / "rf.mat", {"rf": rf})
    with h5py.File(folder / "rf.h5", "w") as file:
        file["rf"] = rf
    np.savetxt(folder / "rf.csv", rf[0, :TEXT_PULSES].T, delimiter=",")
    lines = {"axes": "line,pulse,sample", "lines": "all", "line_pitch_m": 1e-4}
    raw = {"dtype": "float32", "shape": rf.shape}
    return {
        "npy": (folder / "rf.npy", np.load, lines),
        "npz": (folder / "rf.npz", lambda path: np.load(path)["rf"], lines),
        "raw": (folder / "rf.raw", lambda path: np.fromfile(path, np.float32), lines | raw),
        "mat, version 5": (folder / "rf.mat", loadmat, lines),
        "hdf5": (folder / "rf.h5", plain_hdf5, lines),
        "csv": (folder / "rf.csv", lambda path: np.loadtxt(path, delimiter=","), {"axes": "sample,pulse"}),
    }


def elapsed_s(call: Callable[[], Any]) -> float:
    """Return how long ``call`` takes."""
    start_s = time.perf_counter()
    call()
    return time.perf_counter() - start_s


def read(path: Path, lacking: dict[str, Any]) -> Any:
    """Read ``path`` as the import does."""
    settings, origins = read_settings(path, None, RATES | lacking)
    return read_recording(path, settings, origins)


def time_table(rounds: int, folder: Path) -> str:
    """Return the table of times of all formats."""
    rows = []
    for name, (path, plain, lacking) in files(folder).items():
        calls = (
            lambda path=path, plain=plain: plain(path),
            lambda path=path: hashlib.sha256(path.read_bytes()),
            lambda path=path, lacking=lacking: read(path, lacking),
        )
        times = np.array([[elapsed_s(call) for call in calls] for _ in range(rounds)])
        plain_s, with_checksum_s, import_s = times[:, 0], times[:, 0] + times[:, 1], times[:, 2]
        best = [f"{values.min() * 1e3:.1f}" for values in (plain_s, with_checksum_s, import_s)]
        ratios = [f"{np.median(import_s / values):.2f}" for values in (plain_s, with_checksum_s)]
        rows.append([name, *best, *ratios])
    header = ["format", "plain / ms", "plain and SHA-256 / ms", "import / ms", "to plain", "to plain and SHA-256"]
    return text_table(header, rows)


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
    """Print the table, and the memory where the system states it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--gigabytes", type=float, default=0.2)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        print(time_table(arguments.rounds, Path(folder)))
        if sys.platform == "linux":
            print(memory_text(arguments.gigabytes, Path(folder)))


if __name__ == "__main__":
    main()
