"""Within the FDA's limits for people: 200 Hz in muscle and gelatin, with the membrane's echo and without it.

Usage: python scripts/validation/within_limits.py [--scene NAME] [--seeds 2] [--rate-hz 3990] [--no-membrane | --membrane]

Ten seconds of acquisition are five shots of 2 s, of the 200 tonebursts that the bench file allows at most. The mean of
their complex amplitudes, by the prior of media, is taken. Without the membrane the trigger jitter of 1 ns remains;
shots that hold little but noise are then drawn towards 0, each of them, and their mean with them: what counts is the
rms error over the seeds.
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


def measured(scene: hpe.Scene) -> tuple[float, float, float]:
    """Return the amplitude of all shots together, the stated u of one, and the true amplitude, nm."""
    phasor, noise, true = [], [], 0.0
    with tempfile.TemporaryDirectory() as folder:
        for shot in hpe.measure(scene, path=Path(folder) / "run.h5").estimate().shots:
            each = next(one for one in shot.estimates if abs(one.frequency_hz - WANTED_HZ) < 1)
            head = each.headline
            phasor.append(1e9 * head.amplitude_m * np.exp(1j * head.phase_rad))
            noise.append(1e9 * head.amplitude_uncertainty_m)
            true = 1e9 * (each.true_amplitude_m or 0.0)
    return float(abs(np.mean(phasor))), float(np.mean(noise)), true


def main() -> None:
    """Print a row a scene, seed and case."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--scene", choices=SCENES)
    parser.add_argument("--rate-hz", type=float, default=3990.0)
    parser.add_argument("--membrane", action=argparse.BooleanOptionalAction, help="one case alone")
    given = parser.parse_args()
    print(
        "| scene | membrane | pulse rate (Hz) | seeds | 200 Hz (nm) | u of a shot (nm) | true (nm) | over rms error |"
    )
    print("|---|---|---:|---:|---|---:|---:|---:|")
    for name in SCENES if given.scene is None else (given.scene,):
        for membrane in (True, False) if given.membrane is None else (given.membrane,):
            found = [measured(scene_of(name, seed + 1, given.rate_hz, membrane)) for seed in range(given.seeds)]
            amplitude, u, true = np.array(found).T
            off = np.sqrt(np.mean((amplitude - true) ** 2))
            case = f"`{name}` | {'yes' if membrane else 'no'} | {given.rate_hz:g} | {given.seeds}"
            each = ", ".join(f"{one:.2f}" for one in amplitude)
            print(f"| {case} | {each} | {u.mean():.2f} | {true[0]:.2f} | {true[0] / off:.1f} |", flush=True)


if __name__ == "__main__":
    main()
