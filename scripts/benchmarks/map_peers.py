"""Time of a map of 128 lines, 200 depths and 60 pulses beside the Doppler estimators of PyMUST and zea.

The same I and Q for all: the peers give one velocity a pixel, the map amplitude, phase, velocity and their
uncertainties, at one frequency or at ten. Another row has samples in place of I and Q, 16 a pixel. Peers that are not
installed are left out. The least of many times, taken in turn; beside it the processor's, of all threads together;
then the medians of their ratios to the faster peer's in the same round. Where other programs use the machine as well,
the clock says more of these; the map has as many threads as there are cores, PyMUST has one. Numba is loaded before,
where it is installed, as in a session that maps frame after frame; ``--plain`` leaves it out.

    python scripts/benchmarks/map_peers.py [--rounds 15] [--plain]
"""

from __future__ import annotations

import argparse
import importlib
import time
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np

from hpe_rig.arrays import ComplexSingleArray
from hpe_rig.processing import MapSettings, map_pixels
from hpe_rig.result import text_table

LINES, DEPTHS, PULSES = 128, 200, 60
RATE_HZ, CARRIER_HZ, PULSE_RATE_HZ, SPEED = 10e6, 5e6, 4000.0, 1540.0
TEN_HZ = tuple(190.0 * n for n in range(1, 11))


def speckle() -> ComplexSingleArray:
    """Return I and Q (line, depth, pulse) of speckle that vibrates by 300 nm at 190 Hz, 30 dB above its noise."""
    rng, time_s = np.random.default_rng(1), np.arange(PULSES) / PULSE_RATE_HZ
    rate_hz = np.fft.fftfreq(DEPTHS, 1 / RATE_HZ)
    shape = (LINES, DEPTHS, 1)
    spectrum = (rng.normal(size=shape) + 1j * rng.normal(size=shape)) * np.exp(-((rate_hz / 1.5e6) ** 2))[:, None]
    moved_m = 300e-9 * np.sin(2 * np.pi * 190.0 * time_s)
    late = np.exp(-4j * np.pi * (rate_hz[:, None] + CARRIER_HZ) * moved_m / SPEED)
    echo = np.fft.ifft(spectrum * late, axis=1)
    noise = rng.normal(size=echo.shape) + 1j * rng.normal(size=echo.shape)
    return np.asarray(echo + np.sqrt(np.mean(np.abs(echo) ** 2) / 2e3) * noise, np.complex64)


def peers(echo: ComplexSingleArray) -> dict[str, Callable[[], Any]]:
    """Return the peers that are installed, each with the array in the order of axes that it takes."""
    found: dict[str, Callable[[], Any]] = {}
    try:
        pymust = importlib.import_module("pymust")
        known = pymust.utils.Param()
        known.fc, known.PRF, known.c = CARRIER_HZ, PULSE_RATE_HZ, SPEED
        found["PyMUST iq2doppler"] = partial(pymust.iq2doppler, np.ascontiguousarray(echo.swapaxes(0, 1)), known)
    except ImportError:
        pass
    try:
        doppler = importlib.import_module("zea.doppler")
        data = np.ascontiguousarray(echo.transpose(2, 1, 0))
        estimated = partial(doppler.color_doppler, data, CARRIER_HZ, PULSE_RATE_HZ, SPEED)
        # As an array of NumPy: a compiled backend returns before it has computed.
        found["zea color_doppler"] = lambda: np.asarray(estimated())
    except ImportError:
        pass
    return found


def _ratio(times_s: dict[str, list[float]], name: str) -> str:
    """Return the median over the rounds of a way's time over that of the peer that is the faster in the median."""
    of_peers = [times_s[each] for each in times_s if not each.startswith("map")]
    if not of_peers:
        return "-"
    return f"{np.median(np.array(times_s[name]) / min(of_peers, key=np.median)):.2f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--plain", action="store_true")
    asked = parser.parse_args()
    rounds = asked.rounds
    if find_spec("numba") is not None and not asked.plain:
        importlib.import_module("numba")
    echo, time_s = speckle(), np.arange(PULSES) / PULSE_RATE_HZ
    pixels = MapSettings(RATE_HZ, CARRIER_HZ, 1, SPEED, demodulation_hz=CARRIER_HZ)
    gates = MapSettings(4 * RATE_HZ, CARRIER_HZ, 16, SPEED)
    samples = np.random.default_rng(2).normal(size=(LINES, PULSES, 16 * DEPTHS)).astype(np.float32)
    by_pulse = echo.swapaxes(1, 2)
    ways: dict[str, Callable[[], Any]] = peers(echo) | {
        "map, one frequency": partial(map_pixels, by_pulse, time_s, TEN_HZ[:1], pixels),
        "map, ten frequencies": partial(map_pixels, by_pulse, time_s, TEN_HZ, pixels),
        "map of samples, ten frequencies": partial(map_pixels, samples, time_s, TEN_HZ, gates),
    }
    clock: dict[str, list[float]] = {name: [] for name in ways}
    busy: dict[str, list[float]] = {name: [] for name in ways}
    for way in ways.values():
        way()  # compiles what is compiled
    for _ in range(rounds):
        for name, way in ways.items():
            start, begun = time.perf_counter(), time.process_time()
            way()
            clock[name].append(time.perf_counter() - start)
            busy[name].append(time.process_time() - begun)
    rows = [
        (name, f"{1e3 * min(clock[name]):.1f}", f"{1e3 * min(busy[name]):.1f}", _ratio(clock, name), _ratio(busy, name))
        for name in ways
    ]
    print(text_table(("128 x 200 x 60", "ms", "processor ms", "ratio", "processor ratio"), rows, words=1))
    if find_spec("resource") is not None:
        peak = importlib.import_module("resource")
        print(f"largest memory {peak.getrusage(peak.RUSAGE_SELF).ru_maxrss / 1e3:.0f} MB")


if __name__ == "__main__":
    main()
