"""Run times and errors of motion and harmonic estimation beside public peers, on the same arrays in one run.

Peers are optional: statsmodels, filterpy, simdkalman, scikit-image, zea (with jax); what is not installed is left out
and named. NumPy's BLAS has one thread, as in the commands of ``hpe-rig``.
"""

# ruff: noqa: E402
from __future__ import annotations

import os

from hpe_rig.arrays import FloatArray

for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_threads] = "1"

import argparse
import importlib
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hpe_rig.processing import ESTIMATORS, EchoGate, Estimator, Motion, estimate, kalman, least_squares, motion_of
from hpe_rig.validation import MotionCase, gate, twin_echoes

RATE_HZ, FREQUENCY_HZ, NOISE_M = 4000.0, 200.0, 1e-7


def main() -> None:
    """Print one table of harmonic filters and one of motion estimators."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    repeats = parser.parse_args().repeats
    print(f"{'harmonic':44}{'best':>12}{'rms error':>12}")
    for pulses, series in ((100, 1), (100, 1000), (100_000, 1)):
        _harmonic(pulses, series, repeats)
    print(f"\n{'motion':44}{'best':>12}{'rms error':>12}")
    _motion(repeats)
    print(f"\n{'velocity of a steady motion, 1 mm/s':44}{'best':>12}{'error':>12}")
    for pulses, samples in ((100, 130), (4000, 1000)):
        _velocity(pulses, samples, repeats)


def _harmonic(pulses: int, series: int, repeats: int) -> None:
    generator = np.random.default_rng(0)
    time_s = np.arange(pulses) / RATE_HZ
    truth = 1e-6 * np.array([np.cos(0.4), np.sin(0.4)])
    clean = 1e-6 * np.sin(2 * np.pi * FREQUENCY_HZ * time_s + 0.4)
    data = clean + NOISE_M * generator.standard_normal((series, pulses))
    motion = Motion(time_s, data, np.full(data.shape, NOISE_M**2), np.ones(pulses, dtype=bool))
    angle = 2 * np.pi * FREQUENCY_HZ * time_s
    rows = np.stack([np.sin(angle), np.cos(angle)], axis=-1)
    ways: dict[str, Callable[[], FloatArray]] = {
        "hpe_rig least_squares": lambda: least_squares(motion, [FREQUENCY_HZ]).state[:, :2],
        "hpe_rig kalman": lambda: kalman(motion, [FREQUENCY_HZ], innovations=False).state[:, :2],
        "hpe_rig kalman with NIS": lambda: kalman(motion, [FREQUENCY_HZ]).state[:, :2],
        "statsmodels": lambda: _statsmodels(rows, data),
        "statsmodels with innovations": lambda: _statsmodels(rows, data, innovations=True),
        "filterpy": lambda: _filterpy(rows, data),
        "simdkalman (rotating state)": lambda: _simdkalman(time_s, data),
    }
    for name, compute in ways.items():
        # one series at a time, or built for many: what would take minutes is left out
        alone, short = name.startswith(("statsmodels", "filterpy")), name.startswith("simdkalman")
        if (series > 1 and alone) or (pulses > 1000 and short):
            continue
        _line(f"{name}, {series} x {pulses}", compute, truth, 10 * repeats if pulses * series < 10_000 else repeats)


def _statsmodels(rows: FloatArray, data: FloatArray, innovations: bool = False) -> FloatArray:
    module = importlib.import_module("statsmodels.tsa.statespace.kalman_filter")
    found = []
    for series in data:
        model = module.KalmanFilter(k_endog=1, k_states=2)
        # in micrometres: covariances of 1e-14 m^2 fall below its absolute limits
        model.bind(series * 1e6)
        model["design"], model["transition"] = rows.T[None], np.eye(2)
        model["obs_cov"] = np.array([[NOISE_M**2 * 1e12]])
        model.initialize_known(np.zeros(2), 1e8 * np.eye(2))
        filtered = model.filter()
        if innovations:
            # normalised, as the NIS needs them: what the filter itself leaves to be asked for
            _ = filtered.standardized_forecasts_error
        found.append(filtered.filtered_state[:, -1] * 1e-6)
    return np.array(found)


def _filterpy(rows: FloatArray, data: FloatArray) -> FloatArray:
    module = importlib.import_module("filterpy.kalman")
    found = []
    for series in data:
        model = module.KalmanFilter(dim_x=2, dim_z=1)
        model.P, model.R, model.F = 1e-4 * np.eye(2), np.array([[NOISE_M**2]]), np.eye(2)
        for row, value in zip(rows, series, strict=True):
            model.update(value, H=row[None])
        found.append(model.x[:, 0])
    return np.array(found)


def _simdkalman(time_s: FloatArray, data: FloatArray) -> FloatArray:
    module = importlib.import_module("simdkalman")
    angle = 2 * np.pi * FREQUENCY_HZ * (time_s[1] - time_s[0])
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    model = module.KalmanFilter(turn, np.zeros((2, 2)), np.array([[1.0, 0.0]]), NOISE_M**2)
    found = model.compute(
        data, 0, initial_value=np.zeros(2), initial_covariance=1e-4 * np.eye(2), smoothed=False, filtered=True
    )
    last = found.filtered.states.mean[:, -1]
    # the state has turned with the motion: displacement and quadrature now; back to the start
    now = 2 * np.pi * FREQUENCY_HZ * time_s[-1]
    return np.stack(
        [last[:, 0] * np.sin(now) + last[:, 1] * np.cos(now), last[:, 0] * np.cos(now) - last[:, 1] * np.sin(now)], -1
    )


def _motion(repeats: int) -> None:
    case = MotionCase(snr_db=20)
    volts = twin_echoes(case, 1000, np.random.default_rng(1))
    noise_v = np.sqrt(np.mean(volts**2, axis=(-2, -1), keepdims=True)) / 10
    noisy = volts + noise_v * np.random.default_rng(2).standard_normal(volts.shape)
    clean = estimate(gate(case, volts), [FREQUENCY_HZ]).state[:, :2]
    for name in ESTIMATORS:
        compute = lambda name=name: estimate(gate(case, noisy), [FREQUENCY_HZ], name).state[:, :2]  # noqa: E731
        _line(f"hpe_rig {name}, 1000 x 100 x 130", compute, clean, 3)
    one = estimate(gate(case, volts[0]), [FREQUENCY_HZ]).state[:2]
    few = gate(case, noisy[0])
    _line(
        "hpe_rig cross_correlation, 1 x 100 x 130", lambda: _fitted(motion_of(few, "cross_correlation")), one, repeats
    )
    _line("scikit-image phase_cross_correlation", lambda: _skimage(few), one, repeats)
    harmonics = [100.0 * n for n in range(1, 11)]
    time_s = np.arange(4000) / RATE_HZ
    moved_m = np.sum([1e-7 * np.sin(2 * np.pi * f * time_s + n) for n, f in enumerate(harmonics, 1)], axis=0)
    truth = 1e-7 * np.array([np.cos(1), np.sin(1)])
    double = _train(moved_m, 1000)
    single = replace(double, volts=double.volts.astype(np.float32))
    for name in ESTIMATORS:
        for precision, long in (("float64", double), ("float32", single)):
            compute = lambda name=name, long=long: estimate(long, harmonics, name).state[:2]  # noqa: E731
            _line(f"{name}, 4000 x 1000 {precision}, 10 harmonics", compute, truth, repeats)


def _velocity(pulses: int, samples: int, repeats: int) -> None:
    time_s = np.arange(pulses) / RATE_HZ
    echoes = _train(1e-3 * time_s, samples)
    spectrum = np.fft.fft(echoes.volts, axis=-1)
    spectrum[:, samples // 2 :] = 0
    analytic = (2 * np.fft.ifft(spectrum, axis=-1)).astype(np.complex64)[..., None]
    truth = np.array([1e-3])

    def by_zea() -> FloatArray:
        os.environ.setdefault("KERAS_BACKEND", "jax")
        found = importlib.import_module("zea.doppler").color_doppler(analytic, 9e6, RATE_HZ, 1540.0)
        return np.array([-float(np.mean(found))])

    def by_slope(name: Estimator) -> FloatArray:
        return np.polyfit(time_s, motion_of(echoes, name).displacement_m, 1)[:1]

    for name in ("coherent", "kasai"):
        compute = lambda name=name: by_slope(name)  # noqa: E731
        _line(f"hpe_rig {name} and slope, {pulses} x {samples}", compute, truth, 3 * repeats, 1e6, "um/s")
    _line(f"zea color_doppler, {pulses} x {samples}, from IQ", by_zea, truth, 3 * repeats, 1e6, "um/s")


def _fitted(motion: Motion) -> FloatArray:
    return least_squares(motion, [FREQUENCY_HZ]).state[:2]


def _skimage(echoes: EchoGate) -> FloatArray:
    register = importlib.import_module("skimage.registration").phase_cross_correlation
    reference = echoes.volts.mean(axis=0)
    lag = [register(echo, reference, upsample_factor=1000, normalization=None)[0][0] for echo in echoes.volts]
    metres = np.array(lag) / echoes.sample_rate_hz * echoes.sound_speed_m_per_s / 2
    return _fitted(Motion(echoes.pulse_time_s, metres, np.zeros_like(metres), echoes.valid))


def _train(displacement_m: FloatArray, samples: int) -> EchoGate:
    """Return echoes (pulse, sample) of one medium that moves as a whole, 40 dB SNR."""
    generator = np.random.default_rng(3)
    bins = samples // 2 + 1
    spectrum = generator.standard_normal(bins) + 1j * generator.standard_normal(bins)
    frequency_hz = np.fft.rfftfreq(samples, 1e-8)
    spectrum *= np.exp(-(((frequency_hz - 9e6) / 1e6) ** 2))
    volts = np.fft.irfft(spectrum * np.exp(-4j * np.pi * frequency_hz * displacement_m[:, None] / 1540), samples)
    volts += 0.01 * volts.std() * generator.standard_normal(volts.shape)
    pulses = displacement_m.size
    return EchoGate(volts, 100e6, np.arange(pulses) / RATE_HZ, 9e6, 1540.0, np.ones(pulses, dtype=bool))


def _line(
    name: str, compute: Callable[[], FloatArray], truth: FloatArray, repeats: int, scale: float = 1e9, unit: str = "nm"
) -> None:
    times_s = []
    try:
        found = compute()  # imports and compilation are not timed
        for _ in range(repeats):
            start_s = time.perf_counter()
            found = compute()
            times_s.append(time.perf_counter() - start_s)
    except ImportError as error:
        print(f"{name:44}{error.name or 'jax':>14} is not installed")
        return
    wrong = f"{np.sqrt(np.mean((found - truth) ** 2)) * scale:.3g} {unit}"
    print(f"{name:44}{min(times_s) * 1e3:9.3g} ms{wrong:>12}", flush=True)


if __name__ == "__main__":
    main()
