"""Cost against size: scatterers 1e3 to 1e6, echoes 10 to 1e5, realisations 1e2 to 1e5, and pulses 1e3 to 1e6.

Usage: python scripts/benchmarks/cost_against_size.py [scatterers] [echoes] [realisations] [pulses]

Scatterers and echoes: a rigid gate of 130 samples as the twin makes it, with different motion in every echo; 100 echoes
and 1000 scatterers. Realisations: new scatterers, 100 echoes, noise at 20 dB and an estimate of each, a thousand in
memory at a time, and pulses: a whole measurement (`many_pulses.py`), each row in a fresh process with its peak memory.
Processor time; of what takes less than a second the least of three.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

SIZES = {
    "scatterers": (1e3, 1e4, 1e5, 1e6),
    "echoes": (1e1, 1e2, 1e3, 1e4, 1e5),
    "realisations": (1e2, 1e3, 1e4, 1e5),
    "pulses": (1e3, 1e4, 1e5, 1e6),
}
AT_ONCE = 1000


def main() -> None:
    """Print a table for each of the sizes asked for."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("sizes", nargs="*", default=list(SIZES), metavar="SIZE", help=", ".join(SIZES))
    parser.add_argument("--alone", type=int, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if unknown := set(asked.sizes) - SIZES.keys():
        parser.error(f"no such size: {', '.join(unknown)}; there are {', '.join(SIZES)}")
    if asked.alone:
        print(_realisations(asked.alone), flush=True)
        return
    for name in asked.sizes:
        values = SIZES[name]
        if name == "pulses":
            subprocess.run([sys.executable, Path(__file__).with_name("many_pulses.py"), *map(str, values)], check=True)
        elif name == "realisations":
            print("\n| realisations | echoes and noise, s | coherent, s | cross_spectrum, s | peak, MB |")
            print("|---" * 5 + "|")
            for value in values:
                subprocess.run([sys.executable, __file__, "--alone", str(int(value))], check=True)
        else:
            print(f"\n| {name} | way | processor, s |\n|---|---|---|")
            for value in values:
                pair = (int(value), 100) if name == "scatterers" else (1000, int(value))
                print(_echoes(name, *pair), flush=True)


def _echoes(name: str, scatterers: int, echoes: int) -> str:
    from sim_backend.echoes import EchoDelays, hann_pulse, synthesise

    rng = np.random.default_rng(0)
    pulse, gate_s = hann_pulse(9.0e6, 0.065), (np.arange(130) - 64.5) / 100e6
    rest_s = np.sort(rng.uniform(gate_s[0] + pulse.start_s, gate_s[-1] + pulse.end_s, scatterers))
    weight, shape = rng.standard_normal(scatterers), rng.uniform(0.5, 1.0, (1, scatterers))
    amplitude_s = 1e-6 * np.sin(np.arange(echoes)[:, None]) * 2 / 1540
    made = synthesise(EchoDelays(rest_s, shape, amplitude_s), weight, pulse, gate_s, 1e-8)
    taken_s = _least_s(lambda: synthesise(EchoDelays(rest_s, shape, amplitude_s), weight, pulse, gate_s, 1e-8))
    return f"| {scatterers if name == 'scatterers' else echoes} | {made.method} | {taken_s:.2g} |"


def _least_s(compute: Callable[[], object]) -> float:
    taken_s: list[float] = []
    while len(taken_s) < 3 and sum(taken_s) < 3:
        start_s = time.process_time()
        compute()
        taken_s.append(time.process_time() - start_s)
    return min(taken_s)


def _realisations(count: int) -> str:
    # Guarded, as it is not there on Windows.
    import resource

    from hpe_rig.processing import estimate
    from hpe_rig.validation import MotionCase, gate, twin_echoes

    case, used_s = MotionCase(snr_db=20), dict.fromkeys(("echoes", "coherent", "cross_spectrum"), 0.0)
    # What is loaded and compiled once is not counted.
    for name in ("coherent", "cross_spectrum"):
        estimate(gate(case, twin_echoes(case, 64, np.random.default_rng(1))), [case.frequency_hz], name)
    rng = np.random.default_rng(0)
    for first in range(0, count, AT_ONCE):
        start_s = time.process_time()
        volts = twin_echoes(case, min(AT_ONCE, count - first), rng)
        volts += np.sqrt(np.mean(volts**2, axis=(-2, -1), keepdims=True)) / 10 * rng.standard_normal(volts.shape)
        used_s["echoes"] += time.process_time() - start_s
        for name in ("coherent", "cross_spectrum"):
            start_s = time.process_time()
            estimate(gate(case, volts), [case.frequency_hz], name)
            used_s[name] += time.process_time() - start_s
    used = resource.getrusage(resource.RUSAGE_SELF)
    # macOS counts bytes, everybody else kilobytes
    peak_mb = used.ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3)
    return f"| {count} | " + " | ".join(f"{each:.2g}" for each in used_s.values()) + f" | {peak_mb:.0f} |"


if __name__ == "__main__":
    main()
