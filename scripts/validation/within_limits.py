"""Amplitude at 200 Hz in muscle and gelatin within the FDA's limits, with and without a reference membrane.

Usage: python scripts/validation/within_limits.py [--scene NAME] [--seeds 2] [--rate-hz 3990] [--[no-]membrane]

Ten seconds of acquisition are five shots of 2 s, each with the 200 tonebursts that the bench file allows at most. The
result is the magnitude of the mean phasor of the shots, estimated with the medium prior. Without the membrane the
trigger jitter of 1 ns remains. The prior then shrinks shots of low SNR towards 0, so the rms error over the seeds is
the relevant error.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np

import hpe_rig as hpe

SCENES = ("limits-muscle", "limits-gelatin-8")
SHOTS, BURSTS, WANTED_HZ = 5, 200, 200.0


def scene_of(name: str, seed: int, rate_hz: float, membrane: bool) -> hpe.Scene:
    """Return the shipped scene for 10 s, with or without the membrane and its reference gate."""
    settings = hpe.load_scene(name).model_dump(exclude_unset=True, exclude_none=True)
    if not membrane:
        del settings["processing"]["reference_gate_depth_m"], settings["acquisition"]["record_samples"]
        settings["simulation"] = {key: value for key, value in settings["simulation"].items() if key != "scatterers"}
    settings["excitation"]["burst_count"] = BURSTS
    settings["acquisition"]["repeats"] = SHOTS
    settings["tracking"]["pulse_rate_hz"] = rate_hz
    return hpe.Scene.model_validate(settings).with_({"simulation.seed": seed})


def measured(scene: hpe.Scene) -> tuple[float, float, float]:
    """Return the magnitude of the mean phasor, the stated u of one shot, and the true amplitude, nm."""
    phasor, noise, true = [], [], 0.0
    with tempfile.TemporaryDirectory() as folder:
        for shot in hpe.measure(scene, path=Path(folder) / "run.h5").estimate().shots:
            estimate = next(item for item in shot.estimates if abs(item.frequency_hz - WANTED_HZ) < 1)
            phasor.append(1e9 * estimate.amplitude_m * np.exp(1j * estimate.phase_rad))
            noise.append(1e9 * estimate.amplitude_uncertainty_m)
            true = 1e9 * (estimate.true_amplitude_m or 0.0)
    return float(abs(np.mean(phasor))), float(np.mean(noise)), true


def main() -> None:
    """Print one row per scene and case."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--scene", choices=SCENES)
    parser.add_argument("--rate-hz", type=float, default=3990.0)
    parser.add_argument("--membrane", action=argparse.BooleanOptionalAction, help="this case only; default: both")
    arguments = parser.parse_args()
    print(
        "| scene | membrane | pulse rate (Hz) | seeds | 200 Hz (nm) | u of a shot (nm) | true (nm) | true / rms error |"
    )
    print("|---|---|---:|---:|---|---:|---:|---:|")
    for name in SCENES if arguments.scene is None else (arguments.scene,):
        for membrane in (True, False) if arguments.membrane is None else (arguments.membrane,):
            results = [
                measured(scene_of(name, seed + 1, arguments.rate_hz, membrane)) for seed in range(arguments.seeds)
            ]
            amplitude, u, true = np.array(results).T
            rms_error = np.sqrt(np.mean((amplitude - true) ** 2))
            case = f"`{name}` | {'yes' if membrane else 'no'} | {arguments.rate_hz:g} | {arguments.seeds}"
            amplitudes = ", ".join(f"{value:.2f}" for value in amplitude)
            print(f"| {case} | {amplitudes} | {u.mean():.2f} | {true[0]:.2f} | {true[0] / rms_error:.1f} |", flush=True)


if __name__ == "__main__":
    main()
