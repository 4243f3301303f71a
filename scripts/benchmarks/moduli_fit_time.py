"""Measure the processor time of moduli fits: ten harmonics at eight offsets, every law to data of every law.

Displacements up to 800 nm have noise of 0.7 nm per quadrature and speckle of 2 %. The fits have no start values.

    python scripts/benchmarks/moduli_fit_time.py [--commands]
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path

import numpy as np
from process_cost import processor_times_s

from hpe_rig.medium import PushForce
from hpe_rig.moduli import Push, Vibration, fit_medium
from sim_backend.motion import field_transfer
from sim_backend.settings import Specimen

FREQUENCY_HZ = np.arange(100.0, 1001.0, 100.0)
LATERAL_OFFSET_M = np.linspace(1e-3, 8e-3, 8)
PUSH_WIDTH_M = (0.34e-3, 0.34e-3, 3.6e-3)
PUSH = Push(PushForce(PUSH_WIDTH_M[:1], PUSH_WIDTH_M[2]), 100.0, 100e-6)
NOISE_M, SPECKLE, PEAK_M = 0.7e-9, 0.02, 800e-9
MEDIA = {
    "voigt": {},
    "zener": {"branch_modulus_pa": 10e3},
    "power_law": {"power": 0.2},
    "maxwell": {},
}


def main() -> None:
    """Print a row for each medium and a column for each law, or the times of the commands."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--commands", action="store_true", help="time `run gelatin-moduli` and `moduli` instead of the fits"
    )
    if parser.parse_args().commands:
        print_command_times()
        return
    # The first fit loads and compiles.
    fit_medium(simulated_vibrations("voigt"), PUSH)
    print("| data of | " + " | ".join(MEDIA) + " | all, and which is likeliest |")
    print("|---" * (len(MEDIA) + 2) + "|")
    for name in MEDIA:
        vibrations = simulated_vibrations(name)
        fits = [partial(fit_medium, vibrations, PUSH, law) for law in MEDIA]
        fits.append(partial(list, (fit_medium(vibrations, PUSH, law) for law in MEDIA)))
        cells = [f"{min(processor_times_s(fit, 3)):.2f}" for fit in fits]
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


def print_command_times() -> None:
    """Print the median processor time of three runs of each command; a run before them writes the bytecode."""
    with tempfile.TemporaryDirectory() as folder:
        bytecode = {"PYTHONPYCACHEPREFIX": str(Path(folder) / "bytecode"), "PYTHONDONTWRITEBYTECODE": ""}
        environment = os.environ | bytecode | {"PYTHONPATH": str(Path(__file__).parents[2]), "OMP_NUM_THREADS": "1"}
        for command in ("run gelatin-moduli --yes --output m.h5 --overwrite", "moduli m.h5"):
            times_s = []
            for _ in range(4):
                start_s = sum(os.times()[2:4])
                program = [sys.executable, "-m", "hpe_rig", *command.split()]
                subprocess.run(program, cwd=folder, env=environment, check=True, capture_output=True)
                times_s.append(sum(os.times()[2:4]) - start_s)
            print(f"{command}: {sorted(times_s[1:])[1]:.2f} s", flush=True)


def simulated_vibrations(name: str) -> list[Vibration]:
    """Return the twin's motion at every offset in a medium of 9 kPa and 2 Pa s, with noise and speckle."""
    settings = {"medium": name, "shear_modulus_pa": 9e3, "shear_viscosity_pa_s": 2.0, **MEDIA[name]}
    specimen = Specimen.model_validate(settings)
    motion = field_transfer(specimen, PUSH_WIDTH_M, LATERAL_OFFSET_M, np.zeros(1), FREQUENCY_HZ)[:, :, 0]
    motion *= PUSH.spectrum(FREQUENCY_HZ)[:, None]
    motion *= PEAK_M / np.abs(motion).max()
    covariance_m2 = NOISE_M**2 * np.eye(2 * FREQUENCY_HZ.size)
    uncertainties = {"gain_uncertainty": SPECKLE, "phase_uncertainty_rad": SPECKLE}
    rng, vibrations = np.random.default_rng(1), []
    for offset_m, phasor in zip(LATERAL_OFFSET_M.tolist(), motion.T, strict=True):
        # Speckle scales all harmonics of an offset alike; noise is independent.
        phasor_m = phasor * (1 + SPECKLE * complex(*rng.standard_normal(2)))
        phasor_m += NOISE_M * (rng.standard_normal(FREQUENCY_HZ.size) + 1j * rng.standard_normal(FREQUENCY_HZ.size))
        vibrations.append(
            Vibration(f"{offset_m:g} m", FREQUENCY_HZ, phasor_m, covariance_m2, offset_m, **uncertainties)
        )
    return vibrations


if __name__ == "__main__":
    main()
