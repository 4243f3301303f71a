"""Time a map of 128 lines, 200 depths and 60 pulses, compared with the Doppler estimators of PyMUST and zea.

All take the same I and Q. The peers give one velocity per pixel; the map gives amplitude, phase and velocity with their
uncertainties, at one frequency or at ten. A third row of the map takes samples instead of I and Q, 16 per pixel.

All run alternately. The table has the shortest elapsed and processor times (all threads together), then the median
ratios to the faster peer of the same round. The map uses all cores, PyMUST one. Peers that are not installed are left
out.

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
from process_cost import resource_usage

from hpe_rig.arrays import ComplexSingleArray
from hpe_rig.processing import MapSettings, map_pixels
from hpe_rig.result import text_table

LINES, DEPTHS, PULSES = 128, 200, 60
RATE_HZ, CARRIER_HZ, PULSE_RATE_HZ, SOUND_SPEED = 10e6, 5e6, 4000.0, 1540.0
PULSE_TIME_S = np.arange(PULSES) / PULSE_RATE_HZ
FREQUENCIES_HZ = tuple(190.0 * n for n in range(1, 11))


def speckle() -> ComplexSingleArray:
    """Return I and Q (line, depth, pulse) of speckle that vibrates by 300 nm at 190 Hz, with 30 dB SNR."""
    rng = np.random.default_rng(1)
    baseband_hz = np.fft.fftfreq(DEPTHS, 1 / RATE_HZ)
    shape = (LINES, DEPTHS, 1)
    spectrum = (rng.normal(size=shape) + 1j * rng.normal(size=shape)) * np.exp(-((baseband_hz / 1.5e6) ** 2))[:, None]
    displacement_m = 300e-9 * np.sin(2 * np.pi * 190.0 * PULSE_TIME_S)
    phasor = np.exp(-4j * np.pi * (baseband_hz[:, None] + CARRIER_HZ) * displacement_m / SOUND_SPEED)
    echo = np.fft.ifft(spectrum * phasor, axis=1)
    noise = rng.normal(size=echo.shape) + 1j * rng.normal(size=echo.shape)
    return np.asarray(echo + np.sqrt(np.mean(np.abs(echo) ** 2) / 2e3) * noise, np.complex64)


def available_peers(echo: ComplexSingleArray) -> dict[str, Callable[[], Any]]:
    """Return the installed peers, each with the array in the order of axes that it takes."""
    peers: dict[str, Callable[[], Any]] = {}
    try:
        pymust = importlib.import_module("pymust")
        param = pymust.utils.Param()
        param.fc, param.PRF, param.c = CARRIER_HZ, PULSE_RATE_HZ, SOUND_SPEED
        peers["PyMUST iq2doppler"] = partial(pymust.iq2doppler, np.ascontiguousarray(echo.swapaxes(0, 1)), param)
    except ImportError:
        pass
    try:
        doppler = importlib.import_module("zea.doppler")
        data = np.ascontiguousarray(echo.transpose(2, 1, 0))
        estimator = partial(doppler.color_doppler, data, CARRIER_HZ, PULSE_RATE_HZ, SOUND_SPEED)
        # The conversion waits for the result: a compiled backend returns before it has computed.
        peers["zea color_doppler"] = lambda: np.asarray(estimator())
    except ImportError:
        pass
    return peers


def ratio_to_peer(times_s: dict[str, list[float]], name: str) -> str:
    """Return the median over the rounds of the time of ``name`` relative to the peer with the shorter median."""
    peer_times_s = [values for peer, values in times_s.items() if not peer.startswith("map")]
    if not peer_times_s:
        return "-"
    return f"{np.median(np.array(times_s[name]) / min(peer_times_s, key=np.median)):.2f}"


def main() -> None:
    """Time the map and the installed peers alternately and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--plain", action="store_true", help="do not load Numba, even if it is installed")
    options = parser.parse_args()
    if find_spec("numba") is not None and not options.plain:
        # Once Numba is loaded the map uses it, as in a session that maps one frame after another.
        importlib.import_module("numba")
    echo = speckle()
    pixels = MapSettings(RATE_HZ, CARRIER_HZ, 1, SOUND_SPEED, demodulation_hz=CARRIER_HZ)
    gates = MapSettings(4 * RATE_HZ, CARRIER_HZ, 16, SOUND_SPEED)
    samples = np.random.default_rng(2).normal(size=(LINES, PULSES, 16 * DEPTHS)).astype(np.float32)
    by_pulse = echo.swapaxes(1, 2)
    contenders: dict[str, Callable[[], Any]] = available_peers(echo) | {
        "map, one frequency": partial(map_pixels, by_pulse, PULSE_TIME_S, FREQUENCIES_HZ[:1], pixels),
        "map, ten frequencies": partial(map_pixels, by_pulse, PULSE_TIME_S, FREQUENCIES_HZ, pixels),
        "map of samples, ten frequencies": partial(map_pixels, samples, PULSE_TIME_S, FREQUENCIES_HZ, gates),
    }
    elapsed_s: dict[str, list[float]] = {name: [] for name in contenders}
    processor_s: dict[str, list[float]] = {name: [] for name in contenders}
    for compute in contenders.values():
        compute()  # compiles
    for _ in range(options.rounds):
        for name, compute in contenders.items():
            start_s, start_processor_s = time.perf_counter(), time.process_time()
            compute()
            elapsed_s[name].append(time.perf_counter() - start_s)
            processor_s[name].append(time.process_time() - start_processor_s)
    rows = [
        (
            name,
            *(f"{1e3 * min(times_s[name]):.1f}" for times_s in (elapsed_s, processor_s)),
            *(ratio_to_peer(times_s, name) for times_s in (elapsed_s, processor_s)),
        )
        for name in contenders
    ]
    print(text_table(("128 x 200 x 60", "ms", "processor ms", "ratio", "processor ratio"), rows, words=1))
    if find_spec("resource") is not None:
        print(f"peak memory {resource_usage()[1]:.0f} MB")


if __name__ == "__main__":
    main()
