"""Within the FDA's limits for people: 200 Hz in muscle and gelatin, with the membrane's echo and without it.

Usage: python scripts/within_limits.py [--scene NAME] [--seeds 2] [--rate-hz 3990] [--no-membrane | --membrane]

Ten seconds of acquisition are five shots of 2 s, of the 200 tonebursts that the bench file allows at most. The mean of
their complex amplitudes, by the prior of media, is taken. Without the membrane the trigger jitter of 1 ns remains.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np

import hpe_rig as hpe

SCENES = ("limits-muscle", "limits-gelatin-8")
SHOTS, BURSTS, WANTED_HZ = 5, 200, 200.0


def scene_of(name: str, seed: int, rate_hz: float, membrane: bool) -> hpe.Scene:
    """Return the shipped scene for 10 s, without the membrane and its reference gate where they are not wanted."""
    plain = hpe.load_scene(name).model_dump(exclude_unset=True, exclude_none=True)
    if not membrane:
        del plain["processing"]["reference_gate_depth_m"], plain["acquisition"]["record_samples"]
        plain["simulation"] = {key: value for key, value in plain["simulation"].items() if key != "scatterers"}
    plain["excitation"]["burst_count"] = BURSTS
    plain["acquisition"]["repeats"] = SHOTS
    plain["tracking"]["pulse_rate_hz"] = rate_hz
    return hpe.Scene.model_validate(plain).with_({"simulation.seed": seed})


def measured(scene: hpe.Scene, folder: Path) -> tuple[float, float, float]:
    """Return amplitude, its stated u and the true amplitude, nm, of all shots together."""
    run = hpe.measure(scene, path=folder / "run.h5")
    phasor, noise, true = [], [], 0.0
    for shot in run.estimate().shots:
        each = next(one for one in shot.estimates if abs(one.frequency_hz - WANTED_HZ) < 1)
        head = each.headline
        phasor.append(1e9 * head.amplitude_m * np.exp(1j * head.phase_rad))
        noise.append(1e9 * head.amplitude_uncertainty_m)
        true = 1e9 * (each.true_amplitude_m or 0.0)
    return abs(np.mean(phasor)), float(np.sqrt(np.mean(np.square(noise)) / len(noise))), true


def main() -> None:
    """Print a row a scene, seed and case."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--scene", choices=SCENES)
    parser.add_argument("--rate-hz", type=float, default=3990.0)
    parser.add_argument("--membrane", action=argparse.BooleanOptionalAction, help="one case alone")
    given = parser.parse_args()
    print("| scene | membrane | pulses a second | seed | 200 Hz (nm) | u (nm) | true (nm) | true over u |")
    print("|---|---|---:|---:|---:|---:|---:|---:|")
    for name in SCENES if given.scene is None else (given.scene,):
        for membrane in (True, False) if given.membrane is None else (given.membrane,):
            for seed in range(1, given.seeds + 1):
                with tempfile.TemporaryDirectory() as folder:
                    scene = scene_of(name, seed, given.rate_hz, membrane)
                    amplitude, u, true = measured(scene, Path(folder))
                row = f"| `{name}` | {'yes' if membrane else 'no'} | {given.rate_hz:g} | {seed} | {amplitude:.2f}"
                print(f"{row} | {u:.2f} | {true:.2f} | {true / u:.1f} |", flush=True)


if __name__ == "__main__":
    main()
