"""Gate tracking: a gate that follows the echoes through background motion as long as itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hpe_rig.processing.echoes import EchoGate, Motion, margin_samples, valid_volts
from hpe_rig.processing.motion import kasai


def follow(records: EchoGate, gate: slice) -> tuple[EchoGate, Motion]:
    """Return the gate cut out of whole records where the echoes have gone, and how far each cut was moved.

    ``records`` (pulse, sample), whole and without margins, hold what moves into and out of the ``gate``; the motion of
    every cut is a whole number of samples, exactly known, without variance. Add it to the displacement found in the cut
    echoes (``added``). The first look is the sum of consecutive steps in the resting gate. Raises ``ValueError`` for
    more than one train, where a step passes a quarter wavelength, and where the echoes leave the records.
    """
    if records.volts.ndim != 2:
        raise ValueError(f"volts {records.volts.shape}: one train (pulse, sample) at a time can be followed")
    behind = records.volts.shape[1] - gate.stop
    looked = kasai(replace(records, margin=(gate.start, behind)), divide_by="centre")
    coarse_m = looked.displacement_m[records.valid]
    if float(looked.largest_step) > 0.95:
        raise ValueError(
            f"a step of {float(looked.largest_step):.2f} quarter wavelengths is ambiguous with one in the other "
            "direction: raise the pulse rate"
        )
    metre_samples = 2 / records.sound_speed_m_per_s * records.sample_rate_hz
    shift = np.round((coarse_m - np.median(coarse_m)) * metre_samples).astype(np.int64)
    first, last = gate.start + int(shift.min()), gate.stop + int(shift.max())
    if first < 0 or last > records.volts.shape[1]:
        raise ValueError(
            f"the echoes of the gate move through samples {first} to {last}, a record has {records.volts.shape[1]}: "
            "take longer records (acquisition.record_samples) or a shorter window"
        )
    wanted = margin_samples(records.sample_rate_hz, records.carrier_hz)
    margin = min(first, wanted), min(records.volts.shape[1] - last, wanted)
    place = shift[:, None] + np.arange(gate.start - margin[0], gate.stop + margin[1])
    volts = np.zeros((records.valid.size, place.shape[1]))
    volts[records.valid] = np.take_along_axis(valid_volts(records), place, axis=1)
    moved_m = np.full(records.valid.size, np.nan)
    moved_m[records.valid] = shift / metre_samples
    still = np.zeros(records.valid.size)
    return replace(records, volts=volts, margin=margin), Motion(records.pulse_time_s, moved_m, still, records.valid)


def added(motion: Motion, cuts: Motion) -> Motion:
    """Return the displacement found in followed echoes plus that of the cuts."""
    return replace(motion, displacement_m=motion.displacement_m + cuts.displacement_m)
