"""Compare run time and error of motion and harmonic estimation with public packages, on the same arrays.

Optional: statsmodels, filterpy, simdkalman, scikit-image and zea (with jax). Packages that are not installed are named.
"""

# ruff: noqa: E402
from __future__ import annotations

import os

# One BLAS thread, as in the commands of hpe-rig. The libraries read these variables when NumPy is imported.
for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"

import argparse
import importlib
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.processing import ESTIMATORS, EchoGate, Motion, estimate, kalman, least_squares, motion_of
from hpe_rig.scene import Estimator
from hpe_rig.validation import MotionCase

RATE_HZ, FREQUENCY_HZ, NOISE_M = 4000.0, 200.0, 1e-7
SOUND_SPEED = 1540.0
Compute = Callable[[], FloatArray]


def main() -> None:
    """Print one table each of harmonic filters, motion estimators and velocity estimators."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5, help="timed calls per row; the fastest is printed")
    repeats = parser.parse_args().repeats
    print(f"{'harmonic':44}{'best':>12}{'rms error':>12}")
    for pulses, series in ((100, 1), (100, 1000), (100_000, 1)):
        compare_harmonic_filters(pulses, series, repeats)
    print(f"\n{'motion':44}{'best':>12}{'rms error':>12}")
    compare_motion_estimators(repeats)
    compare_long_trains(repeats)
    print(f"\n{'velocity of a steady motion, 1 mm/s':44}{'best':>12}{'error':>12}")
    for pulses, samples in ((100, 130), (4000, 1000)):
        compare_velocity_estimators(pulses, samples, repeats)


def compare_harmonic_filters(pulses: int, series: int, repeats: int) -> None:
    """Fit one harmonic to ``series`` noisy displacements of ``pulses`` each."""
    generator = np.random.default_rng(0)
    time_s = np.arange(pulses) / RATE_HZ
    angle = 2 * np.pi * FREQUENCY_HZ * time_s
    true_state = 1e-6 * np.array([np.cos(0.4), np.sin(0.4)])
    data = 1e-6 * np.sin(angle + 0.4) + NOISE_M * generator.standard_normal((series, pulses))
    motion = Motion(time_s, data, np.full(data.shape, NOISE_M**2), np.ones(pulses, dtype=bool))
    columns = np.stack([np.sin(angle), np.cos(angle)], axis=-1)
    filters: dict[str, Compute] = {
        "hpe_rig least_squares": lambda: least_squares(motion, [FREQUENCY_HZ]).state[:, :2],
        "hpe_rig kalman": lambda: kalman(motion, [FREQUENCY_HZ]).state[:, :2],
        "statsmodels": lambda: _statsmodels(columns, data),
        "statsmodels with innovations": lambda: _statsmodels(columns, data, innovations=True),
        "filterpy": lambda: _filterpy(columns, data),
        "simdkalman (rotating state)": lambda: _simdkalman(time_s, data),
    }
    for name, compute in filters.items():
        # These take minutes: statsmodels and filterpy run one series at a time, simdkalman is slow for long ones.
        slow_for_many, slow_for_long = name.startswith(("statsmodels", "filterpy")), name.startswith("simdkalman")
        if (series > 1 and slow_for_many) or (pulses > 1000 and slow_for_long):
            continue
        calls = 10 * repeats if pulses * series < 10_000 else repeats
        print_row(f"{name}, {series} x {pulses}", compute, true_state, calls)


def _statsmodels(columns: FloatArray, data: FloatArray, innovations: bool = False) -> FloatArray:
    module = importlib.import_module("statsmodels.tsa.statespace.kalman_filter")
    states = []
    for series in data:
        model = module.KalmanFilter(k_endog=1, k_states=2)
        # In micrometres: covariances of 1e-14 m² fall below the absolute limits of statsmodels.
        model.bind(series * 1e6)
        model["design"], model["transition"] = columns.T[None], np.eye(2)
        model["obs_cov"] = np.array([[NOISE_M**2 * 1e12]])
        model.initialize_known(np.zeros(2), 1e8 * np.eye(2))
        filtered = model.filter()
        if innovations:
            # Normalised innovations are computed only on access; the NIS test needs them.
            _ = filtered.standardized_forecasts_error
        states.append(filtered.filtered_state[:, -1] * 1e-6)
    return np.array(states)


def _filterpy(columns: FloatArray, data: FloatArray) -> FloatArray:
    module = importlib.import_module("filterpy.kalman")
    states = []
    for series in data:
        model = module.KalmanFilter(dim_x=2, dim_z=1)
        model.P, model.R, model.F = 1e-4 * np.eye(2), np.array([[NOISE_M**2]]), np.eye(2)
        for row, value in zip(columns, series, strict=True):
            model.update(value, H=row[None])
        states.append(model.x[:, 0])
    return np.array(states)


def _simdkalman(time_s: FloatArray, data: FloatArray) -> FloatArray:
    module = importlib.import_module("simdkalman")
    angle = 2 * np.pi * FREQUENCY_HZ * (time_s[1] - time_s[0])
    rotation = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    model = module.KalmanFilter(rotation, np.zeros((2, 2)), np.array([[1.0, 0.0]]), NOISE_M**2)
    prior = {"initial_value": np.zeros(2), "initial_covariance": 1e-4 * np.eye(2)}
    result = model.compute(data, 0, **prior, smoothed=False, filtered=True)
    in_phase, quadrature = result.filtered.states.mean[:, -1].T
    # The state rotates with the motion: rotate the last one back to time zero.
    angle = 2 * np.pi * FREQUENCY_HZ * time_s[-1]
    sine, cosine = np.sin(angle), np.cos(angle)
    return np.stack([in_phase * sine + quadrature * cosine, in_phase * cosine - quadrature * sine], -1)


def compare_motion_estimators(repeats: int) -> None:
    """Estimate the motion of 1000 simulated gates with every estimator, and of one gate with scikit-image."""
    case = MotionCase(snr_db=20)
    clean_volts = case.twin_echoes(1000, np.random.default_rng(1))
    noise_v = np.sqrt(np.mean(clean_volts**2, axis=(-2, -1), keepdims=True)) / 10
    volts = clean_volts + noise_v * np.random.default_rng(2).standard_normal(clean_volts.shape)
    noise_free = estimate(case.gate(clean_volts), [FREQUENCY_HZ]).state[:, :2]
    for name in ESTIMATORS:
        compute = lambda name=name: estimate(case.gate(volts), [FREQUENCY_HZ], name).state[:, :2]  # noqa: E731
        print_row(f"hpe_rig {name}, 1000 x 100 x 130", compute, noise_free, 3)
    echoes = case.gate(volts[0])
    single: dict[str, Callable[[], Motion]] = {
        "hpe_rig cross_correlation, 1 x 100 x 130": lambda: motion_of(echoes, "cross_correlation"),
        "scikit-image phase_cross_correlation": lambda: _skimage(echoes),
    }
    for name, motion in single.items():
        compute = lambda motion=motion: least_squares(motion(), [FREQUENCY_HZ]).state[:2]  # noqa: E731
        print_row(name, compute, noise_free[0], repeats)


def _skimage(echoes: EchoGate) -> Motion:
    register = importlib.import_module("skimage.registration").phase_cross_correlation
    reference = echoes.volts.mean(axis=0)
    lags = [register(echo, reference, upsample_factor=1000, normalization=None)[0][0] for echo in echoes.volts]
    displacement_m = np.array(lags) / echoes.sample_rate_hz * echoes.sound_speed_m_per_s / 2
    return Motion(echoes.pulse_time_s, displacement_m, np.zeros_like(displacement_m), echoes.valid)


def compare_long_trains(repeats: int) -> None:
    """Estimate ten harmonics from 4000 pulses of 1000 samples with every estimator in both precisions."""
    frequencies_hz = [100.0 * n for n in range(1, 11)]
    time_s = np.arange(4000) / RATE_HZ
    displacement_m = sum(1e-7 * np.sin(2 * np.pi * f * time_s + n) for n, f in enumerate(frequencies_hz, 1))
    true_state = 1e-7 * np.array([np.cos(1), np.sin(1)])
    double = rigid_echoes(displacement_m, 1000)
    gates = {"float64": double, "float32": replace(double, volts=double.volts.astype(np.float32))}
    for name in ESTIMATORS:
        for precision, echoes in gates.items():
            compute = lambda name=name, echoes=echoes: estimate(echoes, frequencies_hz, name).state[:2]  # noqa: E731
            print_row(f"{name}, 4000 x 1000 {precision}, 10 harmonics", compute, true_state, repeats)


def compare_velocity_estimators(pulses: int, samples: int, repeats: int) -> None:
    """Estimate a steady velocity of 1 mm/s."""
    time_s = np.arange(pulses) / RATE_HZ
    echoes = rigid_echoes(1e-3 * time_s, samples)
    # zea takes the analytic signal (pulse, sample, 1) in single precision.
    spectrum = np.fft.fft(echoes.volts, axis=-1)
    spectrum[:, samples // 2 :] = 0
    analytic = (2 * np.fft.ifft(spectrum, axis=-1)).astype(np.complex64)[..., None]

    def zea_velocity() -> FloatArray:
        os.environ.setdefault("KERAS_BACKEND", "jax")
        velocity = importlib.import_module("zea.doppler").color_doppler(analytic, 9e6, RATE_HZ, SOUND_SPEED)
        return np.array([-float(np.mean(velocity))])

    def slope(name: Estimator) -> FloatArray:
        return np.polyfit(time_s, motion_of(echoes, name).displacement_m, 1)[:1]

    estimators: dict[str, Compute] = {
        f"hpe_rig coherent and slope, {pulses} x {samples}": lambda: slope("coherent"),
        f"hpe_rig kasai and slope, {pulses} x {samples}": lambda: slope("kasai"),
        f"zea color_doppler, {pulses} x {samples}, from IQ": zea_velocity,
    }
    for name, compute in estimators.items():
        print_row(name, compute, np.array([1e-3]), 3 * repeats, scale=1e6, unit="um/s")


def rigid_echoes(displacement_m: FloatArray, samples: int) -> EchoGate:
    """Return echoes (pulse, sample) of speckle that moves as a whole, at 40 dB SNR and 9 MHz."""
    generator = np.random.default_rng(3)
    bins = samples // 2 + 1
    spectrum = generator.standard_normal(bins) + 1j * generator.standard_normal(bins)
    frequency_hz = np.fft.rfftfreq(samples, 1e-8)
    spectrum *= np.exp(-(((frequency_hz - 9e6) / 1e6) ** 2))
    # A displacement delays every frequency by the two-way travel time.
    delayed = spectrum * np.exp(-4j * np.pi * frequency_hz * displacement_m[:, None] / SOUND_SPEED)
    volts = np.fft.irfft(delayed, samples)
    volts += 0.01 * volts.std() * generator.standard_normal(volts.shape)
    pulses = displacement_m.size
    return EchoGate(volts, 100e6, np.arange(pulses) / RATE_HZ, 9e6, SOUND_SPEED, np.ones(pulses, dtype=bool))


def print_row(
    name: str, compute: Compute, truth: FloatArray, repeats: int, *, scale: float = 1e9, unit: str = "nm"
) -> None:
    """Print the shortest time of ``repeats`` calls and the rms error, or that a package is missing."""
    times_s = []
    try:
        result = compute()  # the first call, which imports and compiles, is not timed
        for _ in range(repeats):
            start_s = time.perf_counter()
            result = compute()
            times_s.append(time.perf_counter() - start_s)
    except ImportError as error:
        print(f"{name:44}{error.name or 'jax':>14} is not installed")
        return
    rms_error = f"{np.sqrt(np.mean((result - truth) ** 2)) * scale:.3g} {unit}"
    print(f"{name:44}{min(times_s) * 1e3:9.3g} ms{rms_error:>12}", flush=True)


if __name__ == "__main__":
    main()
