"""Processor time of fits of moduli: ten harmonics at eight places, every law to data of every law.

Noise of 0.7 nm a quadrature and speckle of 2 % on motion of 800 nm, seeded; no starting values are given.

    python scripts/benchmarks/moduli_fit_time.py
    python scripts/benchmarks/moduli_fit_time.py --commands     # of `run gelatin-moduli` and `moduli` instead
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from hpe_rig.medium import PushForce
from hpe_rig.moduli import Push, Vibration, compare_media, fit_medium
from sim_backend.motion import field_transfer
from sim_backend.settings import Specimen

FREQUENCY_HZ = np.arange(100.0, 1001.0, 100.0)
LATERAL_M = np.linspace(1e-3, 8e-3, 8)
WIDTH_M = (0.34e-3, 0.34e-3, 3.6e-3)
PUSH = Push(PushForce(WIDTH_M[:1], WIDTH_M[2]), 100.0, 100e-6)
NOISE_M, SPECKLE, LARGEST_M = 0.7e-9, 0.02, 800e-9
MEDIA = {
    "voigt": {},
    "zener": {"branch_modulus_pa": 10e3},
    "power_law": {"power": 0.2},
    "maxwell": {},
}


def main() -> None:
    """Print the table: a row a medium, a column a law; or the commands."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--commands", action="store_true", help="time the commands in place of the fits")
    if parser.parse_args().commands:
        commands()
        return
    fit_medium(vibrations("voigt"), PUSH)
    print("| data of | " + " | ".join(MEDIA) + " | all, and which is likeliest |")
    print("|---" * (len(MEDIA) + 2) + "|")
    for name in MEDIA:
        places = vibrations(name)
        times = [f"{seconds(partial(fit_medium, places, PUSH, law)):.2f}" for law in MEDIA]
        together = seconds(partial(compare_media, places, PUSH, list(MEDIA)))
        print(f"| {name} | " + " | ".join([*times, f"{together:.2f}"]) + " |", flush=True)


def commands() -> None:
    """Print the processor time of both commands, the median of three, with the bytecode of a run before."""
    with tempfile.TemporaryDirectory() as folder:
        kept = {"PYTHONPYCACHEPREFIX": str(Path(folder) / "bytecode"), "PYTHONDONTWRITEBYTECODE": ""}
        environment = os.environ | kept | {"PYTHONPATH": str(Path(__file__).parents[2]), "OMP_NUM_THREADS": "1"}
        for command in ("run gelatin-moduli --yes --output m.h5 --overwrite", "moduli m.h5"):
            found = []
            for _ in range(4):
                begin = sum(os.times()[2:4])
                asked = [sys.executable, "-m", "hpe_rig", *command.split()]
                subprocess.run(asked, cwd=folder, env=environment, check=True, capture_output=True)
                found.append(sum(os.times()[2:4]) - begin)
            print(f"{command}: {sorted(found[1:])[1]:.2f} s", flush=True)


def seconds(work: Callable[[], object]) -> float:
    """Return the processor time of ``work``, the least of three."""
    found = []
    for _ in range(3):
        begin = time.process_time()
        work()
        found.append(time.process_time() - begin)
    return min(found)


def vibrations(name: str) -> list[Vibration]:
    """Return the twin's motion at every place in a medium of 9 kPa and 2 Pa s, with noise and speckle."""
    given = {"medium": name, "shear_modulus_pa": 9e3, "shear_viscosity_pa_s": 2.0, **MEDIA[name]}
    motion = field_transfer(Specimen.model_validate(given), WIDTH_M, LATERAL_M, np.zeros(1), FREQUENCY_HZ)[:, :, 0]
    motion *= PUSH.spectrum(FREQUENCY_HZ)[:, None]
    motion *= LARGEST_M / np.abs(motion).max()
    rng, found = np.random.default_rng(1), []
    for lateral_m, phasor in zip(LATERAL_M.tolist(), motion.T, strict=True):
        speckled = phasor * (1 + SPECKLE * complex(*rng.standard_normal(2)))
        noise_m = NOISE_M * (rng.standard_normal(FREQUENCY_HZ.size) + 1j * rng.standard_normal(FREQUENCY_HZ.size))
        covariance = NOISE_M**2 * np.eye(2 * FREQUENCY_HZ.size)
        own = {"gain_uncertainty": SPECKLE, "phase_uncertainty_rad": SPECKLE}
        found.append(Vibration(f"{lateral_m:g} m", FREQUENCY_HZ, speckled + noise_m, covariance, lateral_m, **own))
    return found


if __name__ == "__main__":
    main()
