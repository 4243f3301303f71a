"""Coverage of a map's 2 u intervals for echoes that decorrelate within the train.

Usage: python scripts/validation/map_decorrelation.py [--pulses 32 100] [--lines 8]

Speckle of known correlation over the pulses, moved as a whole: exponential, exp(-k / L), as of echoes that are renewed
at random, and Gaussian, exp(-k² / 2 L²), as of scatterers that cross the beam. L is the correlation length in pulses.
The motion is 1 um at 200 Hz and a velocity of 200 um/s, with 40 dB. A pixel is one sample of I and Q, or four.

With --disk FILE the rotating disk of PyMUST's repository (examples/data/PWI_disk.mat) follows: a plane wave at 10 kHz,
beamformed here. Its axial velocity is proportional to the lateral position; the errors are those from a line through
all pixels of the disk.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.io import loadmat
from scipy.signal import butter, filtfilt

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.processing import MapSettings, map_pixels
from hpe_rig.result import MotionMap

SAMPLE_HZ, CARRIER_HZ, SPEED, PULSE_HZ = 10e6, 5e6, 1540.0, 4000.0
AMPLITUDE_M, PHASE_RAD, VELOCITY_M_PER_S, VIBRATION_HZ = 1e-6, 0.7, 200e-6, 200.0
LENGTHS = (10, 30, 100, 300, 1000, 10_000)
SAMPLES, SNR_DB, BANDWIDTH = 512, 40.0, 0.3
DISK_CENTRE_M, DISK_RADIUS_M = 22e-3, 9e-3


def correlated(rng: np.random.Generator, shape: tuple[int, int, int], kind: str, length: float) -> ComplexArray:
    """Return complex noise (line, pulse, sample) of variance 2 with a correlation over the pulses."""
    lag = np.abs(np.subtract.outer(np.arange(shape[1]), np.arange(shape[1]))) / length
    values, vectors = np.linalg.eigh(np.exp(-lag if kind == "exponential" else -(lag**2) / 2))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(root @ (rng.normal(size=shape) + 1j * rng.normal(size=shape)))


def speckle(rng: np.random.Generator, shape: tuple[int, int, int], kind: str, length: float) -> ComplexArray:
    """Return I and Q (line, pulse, sample) of moving speckle that decorrelates, with noise."""
    time_s = np.arange(shape[1]) / PULSE_HZ
    baseband_hz = np.fft.fftfreq(shape[2], 1 / SAMPLE_HZ)
    motion_m = AMPLITUDE_M * np.sin(2 * np.pi * VIBRATION_HZ * time_s + PHASE_RAD) + VELOCITY_M_PER_S * time_s
    spectrum = np.fft.fft(correlated(rng, shape, kind, length)) * np.exp(-((baseband_hz / BANDWIDTH / CARRIER_HZ) ** 2))
    echo = np.fft.ifft(spectrum * np.exp(-4j * np.pi * (baseband_hz + CARRIER_HZ) * motion_m[:, None] / SPEED))
    noise = rng.normal(size=shape) + 1j * rng.normal(size=shape)
    return np.asarray(echo + np.sqrt(np.mean(np.abs(echo) ** 2) / 2) * 10 ** (-SNR_DB / 20) * noise)


def inside(error: FloatArray, u: FloatArray) -> str:
    """Return the percentage of errors within 2 u."""
    return f"{100 * np.mean(np.abs(error) < 2 * u):.0f}" if error.size else "-"


def rows(pulse_counts: list[int], lines: int) -> Iterator[str]:
    """Yield the rows of the table of synthetic echoes."""
    for kind in ("exponential", "Gaussian"):
        for length in LENGTHS:
            for pulses in pulse_counts:
                rng = np.random.default_rng(1)
                echo = speckle(rng, (lines, pulses, SAMPLES), kind, length)
                cells = []
                for gate in (1, 4):
                    settings = MapSettings(SAMPLE_HZ, CARRIER_HZ, gate, SPEED, 0.0, 0.0, CARRIER_HZ)
                    result = map_pixels(echo, np.arange(pulses) / PULSE_HZ, [VIBRATION_HZ], settings)
                    cells += cells_of(result)
                yield f"| {kind} | {length} | {pulses} | {' | '.join(cells)} |"


def cells_of(result: MotionMap) -> list[str]:
    """Return the percentage of estimated pixels, and the coverage of amplitude, phase and velocity."""
    good = result.bad == 0
    phase_error = np.angle(np.exp(1j * (result.phase_rad[good, 0] - PHASE_RAD)))
    velocity_error = result.velocity_m_per_s[good] - VELOCITY_M_PER_S
    return [
        f"{100 * good.mean():.0f}",
        inside(result.amplitude_m[good, 0] - AMPLITUDE_M, result.amplitude_uncertainty_m[good, 0]),
        inside(phase_error, result.phase_uncertainty_rad[good, 0]),
        inside(velocity_error, result.velocity_uncertainty_m_per_s[good]),
    ]


def disk(path: Path) -> str:
    """Return the row of the rotating disk: estimated pixels, and the coverage of the velocity."""
    content = loadmat(path, squeeze_me=True)
    values = {name: content["param"][name].item() for name in ("fs", "fc", "c", "t0", "pitch", "PRF")}
    echoes = content["RF"].astype(float)
    element_m = (np.arange(echoes.shape[1]) - (echoes.shape[1] - 1) / 2) * values["pitch"]
    time_s = values["t0"] + np.arange(len(echoes)) / values["fs"]
    mixed = echoes * np.exp(-2j * np.pi * values["fc"] * time_s)[:, None, None]
    baseband = filtfilt(*butter(5, 0.75), mixed, axis=0)
    line_m, depth_m = np.arange(-12e-3, 12.01e-3, 0.6e-3), np.arange(10e-3, 35e-3, 0.5e-3)
    image = np.zeros((line_m.size, echoes.shape[2], depth_m.size), complex)
    # Delay and sum with an aperture of f/1.2; samples between the recorded ones by linear interpolation.
    for index, lateral_m in enumerate(line_m):
        for element, offset_m in enumerate(element_m - lateral_m):
            delay_s = (depth_m + np.hypot(depth_m, offset_m)) / values["c"]
            position = (delay_s - values["t0"]) * values["fs"]
            first = np.clip(position.astype(int), 0, len(echoes) - 2)
            fraction = (position - first)[:, None]
            echo = baseband[first, element] * (1 - fraction) + baseband[first + 1, element] * fraction
            weight = (np.abs(offset_m) < depth_m / 2.4) * np.exp(2j * np.pi * values["fc"] * delay_s)
            image[index] += (echo * weight[:, None]).T
    rate_hz = values["c"] / 2 / 0.5e-3
    settings = MapSettings(rate_hz, values["fc"], 1, values["c"], 0.005, 2 * depth_m[0] / values["c"], values["fc"])
    result = map_pixels(image, np.arange(echoes.shape[2]) / values["PRF"], [VIBRATION_HZ], settings)
    within = np.hypot(line_m[:, None], depth_m - DISK_CENTRE_M) < DISK_RADIUS_M
    good = within & (result.bad == 0)
    velocity, u = result.velocity_m_per_s[good], result.velocity_uncertainty_m_per_s[good]
    lateral_m = np.broadcast_to(line_m[:, None], good.shape)[good]
    slope, offset = np.polyfit(lateral_m, velocity, 1, w=1 / np.hypot(u, 3e-3))
    coverage = inside(velocity - slope * lateral_m - offset, u)
    return f"| {good.sum()} of {within.sum()} | {coverage} | {np.median(u):.3f} | {slope:.1f} |"


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--pulses", type=int, nargs="+", default=[32, 100])
    parser.add_argument("--lines", type=int, default=8, help="lines of 512 samples")
    parser.add_argument("--disk", type=Path, help="PWI_disk.mat of PyMUST's repository")
    arguments = parser.parse_args()
    print("| correlation | L | pulses | 1 sample: pixels, % | A | phase | v | 4 samples: pixels, % | A | phase | v |")
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    for line in rows(arguments.pulses, arguments.lines):
        print(line, flush=True)
    if arguments.disk:
        print("\n| pixels | v, % | u, m/s | rate, 1/s |\n|---|---|---|---|")
        print(disk(arguments.disk))


if __name__ == "__main__":
    main()
