"""Gated echoes of any program as records in memory: the inputs that a shot of a stored run has.

``estimate_trains`` estimates them by the function that estimates stored shots, so that both have one budget and one
set of warnings. Times count from the first pulse.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from drivers.interfaces import Capture, PulseTrain, Toneburst, TriggerPulse
from hpe_rig.arrays import Int16Array
from hpe_rig.plan import Shot, Timeline
from hpe_rig.result import ShotResult
from hpe_rig.scene import Acquisition, Estimator, Processing, Scene, Tracking
from hpe_rig.store import MISSING, ShotRecords

if TYPE_CHECKING:
    from hpe_rig.processing import Estimates

STEPS = 1 << 22
"""Steps from zero to the largest value of samples that are no codes."""
MAX_FREQUENCY_ACCURACY = 0.01
MAX_CODE = 32766
"""Code of the largest value: one below full scale, which counts as clipped."""
FULL_SCALE_CODES = MAX_CODE + 1
"""Code that counts as clipped, as its negative does; the lowest code of 16 bits marks missing records."""
UNSTATED_SCALE_V = 2.0 / (2 * FULL_SCALE_CODES + 1)
"""Volts of one code if they are not stated: full scale, half a code above the highest code, is 1 V."""
Samples = NDArray[np.integer[Any] | np.floating[Any]]


@dataclass(frozen=True, slots=True)
class EchoSettings:
    """Settings of gated echoes, as ``hpe_rig.estimate`` takes them."""

    sample_rate_hz: float
    pulse_rate_hz: float
    carrier_hz: float
    frequencies_hz: Sequence[float]
    sound_speed_m_per_s: float
    margin: tuple[int, int]
    frequency_accuracy: float
    drift: Literal["none", "linear"]

    def refuse_mistakes(self, samples: int) -> None:
        """Raise ``ValueError`` with every setting that is not positive, or if no gate is left of the ``samples``."""
        names = ("sample_rate_hz", "pulse_rate_hz", "carrier_hz", "sound_speed_m_per_s")
        values = {name: getattr(self, name) for name in names}
        mistakes = [f"{name} is {value:g}" for name, value in values.items() if not 0 < value < np.inf]
        if mistakes:
            raise ValueError(f"{', '.join(mistakes)}: each must be positive and finite")
        if not 0 <= self.frequency_accuracy <= MAX_FREQUENCY_ACCURACY:
            limits = f"a relative value from 0 to {MAX_FREQUENCY_ACCURACY:g}"
            raise ValueError(f"frequency_accuracy is {self.frequency_accuracy:g}: {limits}")
        if self.drift not in ("none", "linear"):
            raise ValueError(f"drift is {self.drift!r}: 'none' or 'linear'")
        if min(self.margin) < 0 or sum(self.margin) >= samples:
            raise ValueError(f"margins of {self.margin} samples leave no gate in records of {samples}")


def estimate_trains(trains: Samples, settings: EchoSettings, estimator: Estimator) -> Estimates:
    """Return the estimates of ``trains`` (train, pulse, sample); raise the first ``ValueError`` if no train has one."""
    from hpe_rig.processing import Estimates, estimate_records

    count, pulses, samples = trains.shape
    settings.refuse_mistakes(samples)
    scene = _scene(settings, pulses, samples, estimator)
    shots, errors = list[ShotResult](), dict[int, ValueError]()
    for index, train in enumerate(trains):
        shot = _shot(index, settings, pulses, samples)
        try:
            shots.append(estimate_records(scene, shot, _records(train, settings.margin), estimator, count))
        except ValueError as error:
            errors[index] = error
    if errors and not shots:
        raise errors[0]
    return Estimates(tuple(shots), {index: str(error) for index, error in errors.items()})


def _records(train: Samples, margin: tuple[int, int]) -> ShotRecords:
    """Return the ``train`` (pulse, sample) as records; pulses with a sample that is not finite are missing."""
    unknown_times_s, limits = np.full(train.shape[0], np.nan), (-FULL_SCALE_CODES, FULL_SCALE_CODES)
    if are_codes(train):
        return ShotRecords(signed_codes(train), unknown_times_s, UNSTATED_SCALE_V, 0.0, limits, margin)
    valid = np.isfinite(train).all(axis=-1)
    values = train[valid].astype(np.float64)
    are_whole = np.array_equal(values, np.rint(values))
    offset = values.mean() if values.size else 0.0
    values -= np.rint(offset) if are_whole else offset
    largest = float(np.abs(values).max(initial=0.0))
    # Whole numbers are codes; other values get steps as fine as float32 resolves, so that any unit will do.
    step = 1.0 if are_whole and largest <= STEPS else max(largest / STEPS, float(np.finfo(np.float64).tiny))
    # Half a step is added, so that no sample equals the code of a missing record; the offset is subtracted later.
    codes = np.full(train.shape, MISSING, np.float32)
    codes[valid] = np.rint(values / step) + 0.5
    fine: Any = codes
    return ShotRecords(fine, unknown_times_s, 1 / STEPS, 0.0, (-2 * STEPS, 2 * STEPS), margin)


def _scene(settings: EchoSettings, pulses: int, samples: int, estimator: Estimator) -> Scene:
    """Return a scene of the echoes: tracking without tonebursts, all other settings at their defaults.

    It is not validated: a scene's limits are those of a bench, and any program may have made the echoes.
    """
    gate_samples = samples - sum(settings.margin)
    gate_length_m = gate_samples / settings.sample_rate_hz * settings.sound_speed_m_per_s / 2
    return Scene.model_construct(
        title="Echoes",
        tracking=Tracking.model_construct(
            pulse_rate_hz=settings.pulse_rate_hz, pulse_count=pulses, carrier_hz=settings.carrier_hz
        ),
        acquisition=Acquisition.model_construct(
            gate_depth_m=gate_length_m / 2,
            gate_length_m=gate_length_m,
            sound_speed_m_per_s=settings.sound_speed_m_per_s,
            sample_rate_hz=settings.sample_rate_hz,
            record_samples=samples,
        ),
        processing=Processing.model_construct(
            frequencies_hz=tuple(settings.frequencies_hz),
            frequency_accuracy=settings.frequency_accuracy,
            drift=settings.drift,
            estimator=estimator,
        ),
    )


def _shot(index: int, settings: EchoSettings, pulses: int, samples: int) -> Shot:
    """Return a shot with one pulse every ``1 / pulse_rate_hz``; the first senses the motion at time zero.

    No instrument is known, so their voltages and loads are 0.
    """
    before_s, after_s = (count / settings.sample_rate_hz for count in settings.margin)
    # A gate around the transducer has no travel time.
    gate_end_s = (samples - sum(settings.margin)) / settings.sample_rate_hz / 2
    return Shot(
        index=index,
        repeat=0,
        force_fraction=None,
        master=TriggerPulse(0.0, 0.0, 0.0),
        burst_train=None,
        toneburst=None,
        tracking_train=PulseTrain(settings.pulse_rate_hz, pulses, 0.0, 0.0, 0.0, 0.0),
        tracking_pulser=Toneburst(settings.carrier_hz, 1, 0.0, 0.0, 0.0),
        capture=Capture(settings.sample_rate_hz, samples, 0, pulses, 0.0, 0.0),
        timeline=Timeline(
            burst_onset_s=np.zeros(0),
            burst_length_s=0.0,
            pulse_onset_s=np.arange(pulses) / settings.pulse_rate_hz,
            pulse_length_s=0.0,
            gate_offset_s=(-gate_end_s, gate_end_s),
            record_offset_s=(-gate_end_s - before_s, gate_end_s + after_s),
        ),
    )


def are_codes(values: NDArray[Any]) -> bool:
    """Return whether ``values`` are integers of up to 16 bits, which are kept as they are."""
    return values.dtype.kind in "iu" and values.dtype.itemsize <= 2


def zero_code(values: NDArray[Any]) -> int:
    """Return the integer that is zero volts: 0, or the middle of the range of integers without sign."""
    return 0 if values.dtype.kind == "i" else 1 << (8 * values.dtype.itemsize - 1)


def signed_codes(values: NDArray[Any]) -> Int16Array:
    """Return integers of up to 16 bits as codes around zero; the lowest code is replaced by the next higher one."""
    return np.maximum(values.astype(np.int32) - zero_code(values), -FULL_SCALE_CODES).astype(np.int16)
