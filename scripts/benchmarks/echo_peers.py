"""Public echo simulators, each as a function from scatterers to one echo, for `benchmark_echo.py`.

The program needs none of them. Simulators that are not installed are named with the reason.
"""

from __future__ import annotations

import os
from collections.abc import Callable

import numpy as np

from sim_backend.echoes import direct_sum, hann_pulse

SOUND_SPEED, DEPTH_M, CARRIER_HZ, RATE_HZ = 1540.0, 70e-3, 9.0e6, 100.0e6
GATE_S = (np.arange(130) - 64.5) / RATE_HZ
PULSE = hann_pulse(CARRIER_HZ, 0.065)

PEER_MODELS = {
    "PyMUST": "element directivity, diffraction, a PZT band and the whole trace from 0; not eq. (9), (8) and (12)",
    "FastSIMUS": "as PyMUST, on arrays, in double precision; not eq. (9), (8) and (12)",
    "zea": "transmit and receive apertures of arrays; positions in float32",
    "finufft": "the same sum by frequency, so the Hann pulse's tail beyond 50 MHz is cut",
}
Peer = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""One echo (sample,) from lateral offset and depth beyond the focus (scatterer,), m, and strength (scatterer,)."""


def available_peers() -> tuple[dict[str, Peer], list[str]]:
    """Return the simulators that run here, after a first call, and the missing ones with the reason."""
    peers, missing = {}, []
    for name, create in {"finufft": _finufft, "PyMUST": _pymust, "FastSIMUS": _fastsimus, "zea": _zea}.items():
        try:
            peer = create()
            peer(np.zeros(1), np.zeros(1), np.ones(1))
            peers[name] = peer
        except ImportError as error:
            missing.append(f"{name} ({error})")
        except Exception as error:
            missing.append(f"{name} (installed, but: {type(error).__name__}: {error})")
    return peers, missing


def _finufft() -> Peer:
    """Return the direct sum as a type 1 transform per echo at the Fourier frequencies of the samples."""
    import finufft

    count = 512
    frequency_hz = np.fft.rfftfreq(count, 1 / RATE_HZ)
    time_s = (np.arange(count) - count // 2) / RATE_HZ
    waveform = direct_sum(np.zeros((1, 1)), np.ones(1), PULSE, time_s)[0]
    # The phase makes the gate's first sample the first sample of the inverse transform.
    spectrum = np.fft.rfft(np.fft.ifftshift(waveform)) * np.exp(2j * np.pi * frequency_hz * GATE_S[0])
    plan = finufft.Plan(1, (count + 2,), eps=1e-9, isign=-1, nthreads=1)

    def echo(x_m: np.ndarray, z_m: np.ndarray, strength: np.ndarray) -> np.ndarray:
        plan.setpts(2 * np.pi * RATE_HZ / count * (2 / SOUND_SPEED) * z_m)
        modes = plan.execute(strength.astype(complex))
        positive = modes[count // 2 + 1 :][: len(frequency_hz)]
        return np.fft.irfft(positive * spectrum, count)[: len(GATE_S)]

    return echo


def _pymust() -> Peer:
    import pymust

    param, options = pymust.utils.Param(), pymust.utils.Options()
    param.fc, param.fs, param.c, param.radius, param.Nelements = CARRIER_HZ, RATE_HZ, SOUND_SPEED, np.inf, 1
    param.pitch, param.width, param.kerf, param.bandwidth, param.TXnow = 1.1e-4, 1e-4, 1e-5, 40.0, 3
    options.ParPool = False

    def echo(x_m: np.ndarray, z_m: np.ndarray, strength: np.ndarray) -> np.ndarray:
        columns = (x_m[:, None], DEPTH_M + z_m[:, None], strength[:, None], np.zeros((1, 1)))
        return np.ravel(pymust.simus(*columns, param, options)[0])

    return echo


def _fastsimus() -> Peer:
    import fast_simus
    import jax

    params = fast_simus.TransducerParams(freq_center=CARRIER_HZ, pitch=1.1e-4, n_elements=1, width=1e-4, bandwidth=0.4)

    def echo(x_m: np.ndarray, z_m: np.ndarray, strength: np.ndarray) -> np.ndarray:
        positions_m = np.stack([x_m, DEPTH_M + z_m], axis=1)
        # FastSIMUS computes in the precision of its arrays; zea needs single precision, so double is enabled locally.
        with jax.enable_x64(True):
            result = fast_simus.simus(positions_m, strength, np.zeros(1), params, fs=RATE_HZ, tx_n_wavelengths=3)
        return np.ravel(np.asarray(getattr(result, "rf", result)))

    return echo


def _zea() -> Peer:
    os.environ.setdefault("KERAS_BACKEND", "jax")
    import jax
    from zea.simulator_time_domain import simulate_rf_td

    def simulate(positions_m: object, strength: object) -> object:
        return simulate_rf_td(
            positions_m,
            strength,
            probe_geometry=np.zeros((1, 3), dtype=np.float32),
            apply_lens_correction=False,
            lens_thickness=1e-3,
            lens_sound_speed=1000.0,
            sound_speed=SOUND_SPEED,
            n_ax=len(GATE_S),
            center_frequency=CARRIER_HZ,
            sampling_frequency=RATE_HZ,
            t0_delays=np.zeros((1, 1), dtype=np.float32),
            initial_times=np.full(1, 2 * DEPTH_M / SOUND_SPEED + GATE_S[0]),
            element_width=1e-4,
            attenuation_coef=0.0,
            tx_apodizations=np.ones((1, 1), dtype=np.float32),
            t_peak=np.zeros(1, dtype=np.float32),
        )

    compiled = jax.jit(simulate)

    def echo(x_m: np.ndarray, z_m: np.ndarray, strength: np.ndarray) -> np.ndarray:
        positions_m = np.stack([x_m, np.zeros(len(x_m)), DEPTH_M + z_m], axis=1)
        return np.ravel(np.asarray(compiled(positions_m, strength)))

    return echo
