"""Error against run time of the receive chain over the truncation of its filters and over the oversampling."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from hpe_rig.arrays import FloatArray, Int64Array
from hpe_rig.validation.accuracy.work_precision import Point, measured

if TYPE_CHECKING:
    from sim_backend.settings import ReceiveChain
    from sim_backend.wiring import Capture

RECORDS, SAMPLES = 100, 512


def points() -> Iterator[Point]:
    """Yield points of the linear and the logarithmic chain of the paper, for several truncations and oversamplings."""
    from sim_backend.receiver import with_reception
    from sim_backend.settings import ReceiveChain, SimulationSettings
    from sim_backend.wiring import Capture, no_bursts

    first_ps = 90_000_000 + np.arange(RECORDS) * 250_000_000
    capture = Capture(0, 0, first_ps.astype(np.int64), 10_000, SAMPLES)

    def received(chain: ReceiveChain) -> FloatArray:
        physics = with_reception(_Speckle(), SimulationSettings(receive_chain=chain))
        return physics.record_volts(no_bursts(), no_bursts(), capture)

    paper = ReceiveChain.model_validate({"preset": "paper", "noise_v_per_sqrt_hz": None})
    linear = paper.model_copy(update={"log_amplifier": None})
    for case, chain in (("linear chain", linear), ("logarithmic chain", paper)):
        # Reference: long filters at the highest oversampling.
        exact = received(chain.model_copy(update={"oversampling": 10, "tail_tolerance": 1e-14}))
        for tolerance in (1e-2, 1e-4, 1e-6, 1e-8, 1e-12):
            truncated = chain.model_copy(update={"tail_tolerance": tolerance, "oversampling": 5})
            yield measured(case, "oversampling 5", f"tail {tolerance:g}", partial(received, truncated), exact)
        for factor in (1, 2, 5, 10):
            oversampled = chain.model_copy(update={"tail_tolerance": 1e-10, "oversampling": factor})
            yield measured(case, f"oversampling {factor}", "tail 1e-10", partial(received, oversampled), exact)


class _Speckle:
    """Echoes of 60 point scatterers, Hann pulses of 1.7 us at 9 MHz, at any sample times."""

    def __init__(self) -> None:
        rng = np.random.default_rng(1)
        self._delay_s = rng.uniform(-3e-6, 9e-6, 60)
        self._strength_v = 1e-3 * rng.standard_normal(60)

    def record_volts(self, tonebursts: object, pulses: object, capture: Capture) -> FloatArray:
        offset_s = (capture.first_sample_ps[0] - 90_000_000) * 1e-12
        time_s = offset_s + np.arange(capture.samples) * (capture.sample_period_ps * 1e-12)
        age_s = time_s[:, None] - self._delay_s
        envelope = np.where(np.abs(age_s) < 0.85e-6, np.cos(np.pi * age_s / 1.7e-6) ** 2, 0.0)
        echo = (envelope * np.cos(2 * np.pi * 9e6 * age_s)) @ self._strength_v
        return np.repeat(echo[None], len(capture.first_sample_ps), axis=0)

    def focus_displacement_m(
        self, tonebursts: object, time_ps: Int64Array, origin_ps: int, *, index: int = 0
    ) -> FloatArray:
        return np.zeros(len(time_ps))
