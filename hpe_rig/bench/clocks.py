"""Clocks of a bench: how far the rates of the motion, of the pulses and of the digitizer may differ.

A generator or digitizer with ``common_reference`` has the rate of the shared 10 MHz reference, any other its internal
clock's. The relative rate errors are normal with the accuracies as standard deviations.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.bench.bench_file import BenchFile
from hpe_rig.bench.twin import twin_of
from hpe_rig.scene import UNSTATED_FREQUENCY_ACCURACY, Scene

ONE_CLOCK: Final = np.zeros((3, 3))
"""Covariance of clocks that have the same rate: their differences are zero."""


def clock_covariance(scene: Scene, bench: BenchFile) -> FloatArray:
    """Return the covariance (3, 3) of the relative rate errors of three clocks.

    They are the clock of the motion's frequencies, the tracking train's and the digitizer's. Tonebursts have the clock
    of the burst train; any other source of motion has an unknown one, and so have imported recordings. On the twin the
    instruments share a reference unless the scene sets clock errors.
    """
    twin = twin_of(scene) if bench.simulated else None
    if twin is not None and not twin.has_clock_errors:
        return ONE_CLOCK
    if bench.recording is not None:
        return np.diag([UNSTATED_FREQUENCY_ACCURACY**2, 0.0, 0.0])
    generators = bench.generators
    source = generators.burst_train if scene.excitation is not None else None
    clocks = (source, generators.tracking_train, bench.digitizer)
    accuracy = np.array([UNSTATED_FREQUENCY_ACCURACY if clock is None else clock.clock_uncertainty for clock in clocks])
    is_locked = np.array([clock is not None and bool(clock.common_reference) for clock in clocks])
    covariance = np.diag(accuracy**2)
    # Locked clocks have one rate, so that its error cancels in their differences; it is at most that of the worst.
    covariance[np.ix_(is_locked, is_locked)] = np.max(accuracy[is_locked] ** 2, initial=0.0)
    return covariance
