"""Voltage at an input channel of the board that cables lead to directly, without transducer and receiver."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from sim_backend.arrays import FloatArray, Int64Array
from sim_backend.wiring import PS_PER_S, Bursts, Cable, Capture, Emission, elapsed_ps

INPUTS = ("digitizer.channel_a", "digitizer.channel_b")
"""Inputs that a cable can lead to, by the number of the channel."""
BURST_DIVIDER = 1 / 3
"""A T piece in a line of 50 ohm that ends in 50 ohm: two such loads in parallel at a source of 50 ohm."""


def direct_volts(
    cables: Sequence[Cable], emissions: Mapping[str, Emission], capture: Capture, records: slice
) -> FloatArray:
    """Return the voltage at an input, V (record, sample), in consecutive ``records``: the sum over its ``cables``.

    ``emissions``: voltage steps and bursts of every output, by role. The steps are already halved for the 50 ohm of
    the input (by `propagate`); the bursts are not.
    """
    since_first_ps = elapsed_ps(np.arange(capture.samples) * capture.sample_period_ps, capture.clock_error)
    sample_ps = capture.first_sample_ps[records, None] + since_first_ps
    volts = np.zeros(sample_ps.shape)
    for cable in cables:
        emission = emissions[cable.source_role]
        volts += _stepped(cable, emission, sample_ps)
        volts += cable.sign * _oscillating(emission.bursts, sample_ps - cable.delay_ps)
    return volts


def _stepped(cable: Cable, emission: Emission, sample_ps: Int64Array) -> FloatArray:
    """Return the voltage of the steps that ``cable`` carries at ``sample_ps``, in their shape."""
    steps = cable.carried(emission.steps)
    if not steps.time_ps.size:
        return np.zeros(sample_ps.shape)
    level_v = np.concatenate([steps.before_v[:1], steps.after_v])
    volts: FloatArray = level_v[np.searchsorted(steps.time_ps, sample_ps, side="right")]
    return volts


def _oscillating(bursts: Bursts, time_ps: Int64Array) -> FloatArray:
    """Return the voltage of a generator's ``bursts`` at ``time_ps``, any shape: sines from their onset to their end."""
    volts = np.zeros(time_ps.shape)
    if not bursts.onset_ps.size:
        return volts
    # The bursts ascend in time and do not overlap, so only the last one to begin can be on.
    last = np.searchsorted(bursts.onset_ps, time_ps, side="right") - 1
    inside = (last >= 0) & (time_ps < bursts.end_ps[last])
    burst = last[inside]
    phase = 2 * np.pi * bursts.carrier_hz[burst] * (time_ps[inside] - bursts.onset_ps[burst]) / PS_PER_S
    volts[inside] = BURST_DIVIDER * bursts.amplitude_vpp[burst] / 2 * np.sin(phase)
    return volts
