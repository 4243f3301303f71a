"""Rate of the tonebursts by the clock of the pulses, from the records of the second input.

    phase_k = 2 pi f_b (t_k (1 + e) - n_k / f_r) + constant

    t_k  nominal start of record k, which lies within toneburst n_k
    f_b  carrier of the tonebursts, f_r their rate
    e    rate error of the tonebursts

A record seldom holds the onset of a toneburst, but pulses that shift against the tonebursts often record inside one.
The phase of its carrier there times it to a fraction of a sampling period, apart from whole periods of the carrier. A
scan of e over all records resolves these, except for equally many carrier periods more between all tonebursts: e and
e + f_r / (g f_b) have the same phases, with g the common divisor of the steps of n_k. The accuracies of the clocks or
the displacement must select one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray, IndexArray
from hpe_rig.plan import Shot
from hpe_rig.processing.echo.conditioning import code_statistics
from hpe_rig.processing.echo.gate import BLOCK_SAMPLES
from hpe_rig.processing.harmonics.rate_error import RateError

if TYPE_CHECKING:
    from hpe_rig.store import Placement, StoredRun

MIN_RECORDS: Final = 5
"""Number of records within tonebursts below which no rate is measured; these span at least a period of the bursts."""
MIN_PURITY: Final = 0.5
"""Part of a record, or of its energy in the carrier, above which it lies within a toneburst: a clipped sine has 0.8."""
MIN_AMPLITUDE: Final = 0.3
"""Amplitude of such a record over the largest one: crosstalk of echoes is far weaker."""
MAX_SCATTER_RAD: Final = 0.5
"""Scatter of the phases about the line above which they do not belong to a train of constant rate."""
MIN_LOG_RATIO: Final = 7.0
"""Logarithm of the likelihood ratio to the second most probable rate error above which the first is certain."""
MAX_PRIOR_PERIODS: Final = 1 / 6
"""Standard uncertainty of a known rate error, in carrier periods between tonebursts, that still selects one."""
OVERSAMPLING: Final = 8
"""Scanned rate errors within the width of a maximum."""
MIN_POWER: Final = 0.8
"""Power of a maximum over the highest one above which it is compared; between scanned values power falls by 5 %."""
MAX_MAXIMA: Final = 100
"""Number of maxima that are compared."""


@dataclass(frozen=True, slots=True)
class ToneburstPhases:
    """Phases of the carrier in the records of one shot that lie within tonebursts.

    ``pulse`` (record,): number of the pulse. ``phase_rad`` (record,): measured phase less that of nominal times.
    ``expected``: number of such records by nominal times. The rates and the carrier are nominal. ``damaged``: number of
    records of the second input that fail their checksums, which are left out.
    """

    pulse: FloatArray
    phase_rad: FloatArray
    expected: int
    pulse_rate_hz: float
    burst_rate_hz: float
    carrier_hz: float
    sample_rate_hz: float
    damaged: int = 0

    def rate_error(self, prior_error: RateError) -> RateError | None:
        """Return the rate error of the tonebursts by the clock of the pulses; None if the phases do not determine it.

        ``prior_error``: what the clocks' accuracies state of it.
        """
        time_s = self.pulse / self.pulse_rate_hz
        if not _are_enough(time_s, self.burst_rate_hz) or not prior_error.uncertainty:
            return None
        errors, variances_s2 = self._fitted(time_s, self._maxima(prior_error.value))
        # Times scatter at least by their rounding to samples.
        variance_s2 = max(float(variances_s2.min()), 1 / self.sample_rate_hz**2 / 12)
        freedom = self.pulse.size - 2.0
        log_likelihood = -freedom * variances_s2 / variance_s2 / 2
        # One carrier period more or less between tonebursts gives the same phases.
        errors = errors[:, None] + np.array([-1, 0, 1]) * self.burst_rate_hz / self.carrier_hz
        log_posterior = log_likelihood[:, None] - ((errors - prior_error.value) / prior_error.uncertainty) ** 2 / 2
        best = np.unravel_index(int(np.argmax(log_posterior)), errors.shape)
        # Maxima that lead to the same one by least squares are no alternatives.
        is_other = np.abs(errors - errors[best]) > 0.5 / self.carrier_hz / float(np.ptp(time_s))
        is_certain = log_posterior[best] - np.max(log_posterior[is_other]) > MIN_LOG_RATIO
        scatter_s = math.sqrt(float(variances_s2[best[0]]))
        uncertainty = slope_uncertainty(time_s, self.sample_rate_hz, scatter_s)
        is_line = 2 * np.pi * self.carrier_hz * scatter_s < MAX_SCATTER_RAD
        is_useful = is_certain and is_line and uncertainty < prior_error.uncertainty
        return RateError(float(errors[best]), uncertainty, freedom, 0.0) if is_useful else None

    def _maxima(self, centre: float) -> FloatArray:
        """Return the rate errors near ``centre`` at which the phases agree best, to a part of a maximum's width.

        They differ from ``centre`` by at most half a carrier period between tonebursts.
        """
        pulse = (self.pulse - self.pulse.min()).astype(np.int64)
        size = 1 << math.ceil(math.log2(OVERSAMPLING * (int(pulse.max()) + 1)))
        phasors = np.zeros(size, np.complex128)
        centre_rad = 2 * np.pi * self.carrier_hz * centre * pulse / self.pulse_rate_hz
        phasors[pulse] = np.exp(1j * (self.phase_rad - centre_rad))
        power, turns_per_s = np.abs(np.fft.fft(phasors)) ** 2, np.fft.fftfreq(size, 1 / self.pulse_rate_hz)
        power[np.abs(turns_per_s) > self.burst_rate_hz / 2] = 0.0
        is_maximum = (power >= np.roll(power, 1)) & (power >= np.roll(power, -1))
        candidates = np.flatnonzero(is_maximum & (power > MIN_POWER * power.max()))
        candidates = candidates[np.argsort(-power[candidates])][:MAX_MAXIMA]
        return np.asarray(centre + turns_per_s[candidates] / self.carrier_hz)

    def _fitted(self, time_s: FloatArray, errors: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the least-squares rate errors (candidate,) near ``errors``, and the variances of the times, s².

        ``time_s`` (record,): time of each record.
        """
        radian_s = 2 * np.pi * self.carrier_hz
        remaining = np.exp(1j * (self.phase_rad - radian_s * errors[:, None] * time_s))
        # Phases relative to their mean are far below half a turn.
        delay_s = np.angle(remaining / remaining.mean(axis=1, keepdims=True)) / radian_s
        centred_s = time_s - time_s.mean()
        slope = delay_s @ centred_s / (centred_s @ centred_s)
        residual_s = delay_s - delay_s.mean(axis=1, keepdims=True) - slope[:, None] * centred_s
        return errors + slope, np.sum(residual_s**2, axis=1) / (time_s.size - 2)


def slope_uncertainty(time_s: FloatArray, sample_rate_hz: float, scatter_s: float = 0.0) -> float:
    """Return the standard uncertainty of a relative rate error from records at ``time_s`` (record,).

    ``scatter_s``: observed standard deviation of their times about a line, at least that of rounding to samples.
    Rounding counts as random; it is for clocks that differ by more than 0.1 ppm.
    """
    return max(scatter_s, 1 / sample_rate_hz / math.sqrt(12)) / (math.sqrt(time_s.size) * float(np.std(time_s)))


def predicted_uncertainty(shot: Shot, known_u: float) -> float | None:
    """Return the standard uncertainty of the tonebursts' rate error that the second input will leave in ``shot``.

    ``known_u``: uncertainty of the rate error without it. None if it cannot measure the rate, or not better.
    """
    tone, train, pulse = shot.toneburst, shot.burst_train, within_tonebursts(shot)
    if tone is None or train is None or not pulse.size:
        return None
    period_step = int(np.gcd.reduce(np.diff(_nearest_tonebursts(shot, pulse)[0])))
    if known_u > MAX_PRIOR_PERIODS * train.rate_hz / (period_step * tone.carrier_hz):
        return None
    uncertainty = slope_uncertainty(pulse / shot.tracking_train.rate_hz, shot.capture.sample_rate_hz)
    return uncertainty if uncertainty < known_u else None


def within_tonebursts(shot: Shot) -> IndexArray:
    """Return the numbers (record,) of the pulses whose records lie mostly within a toneburst by nominal times.

    Empty if the second input does not record tonebursts, or too few to measure their rate.
    """
    if not _records_tonebursts(shot) or shot.burst_train is None:
        return np.zeros(0, np.intp)
    line, record_s = shot.timeline, _record_length_s(shot)
    burst, start_s = _nearest_tonebursts(shot, np.arange(line.pulse_onset_s.size))
    overlap_s = np.minimum(start_s + record_s, line.burst_length_s) - np.maximum(start_s, 0.0)
    is_within = (overlap_s > MIN_PURITY * record_s) & (burst >= 0) & (burst < line.burst_onset_s.size)
    pulse = np.flatnonzero(is_within)
    return pulse if _are_enough(pulse / shot.tracking_train.rate_hz, shot.burst_train.rate_hz) else pulse[:0]


def _nearest_tonebursts(shot: Shot, pulse: IndexArray) -> tuple[IndexArray, FloatArray]:
    """Return the toneburst whose centre is nearest to each record's by nominal times, and the record's start after it.

    ``pulse`` (record,): pulse of each record. Tonebursts are counted from 0, also before the first and after the last.
    """
    line, train = shot.timeline, shot.burst_train
    burst_rate_hz = math.nan if train is None else train.rate_hz
    time_s = line.pulse_onset_s[pulse] + line.record_offset_s[0] - line.burst_onset_s[0]
    burst = np.rint((time_s + (_record_length_s(shot) - line.burst_length_s) / 2) * burst_rate_hz)
    return burst.astype(np.intp), time_s - burst / burst_rate_hz


def _are_enough(time_s: FloatArray, burst_rate_hz: float) -> bool:
    """Return whether records within tonebursts, at ``time_s`` (record,), are many enough and in several tonebursts."""
    return time_s.size >= MIN_RECORDS and float(np.ptp(time_s)) * burst_rate_hz >= 1


def _records_tonebursts(shot: Shot) -> bool:
    """Return whether the second input records tonebursts, in records no longer than a toneburst and a pause.

    A record longer than a toneburst extends beyond it; one longer than the pause between tonebursts may contain two.
    """
    line, train = shot.timeline, shot.burst_train
    if shot.capture.monitor_range_v is None or shot.toneburst is None or train is None or shot.is_control:
        return False
    return _record_length_s(shot) <= min(line.burst_length_s, 1 / train.rate_hz - line.burst_length_s)


def _record_length_s(shot: Shot) -> float:
    """Return the length of the records of ``shot``."""
    start_s, end_s = shot.timeline.record_offset_s
    return end_s - start_s


def toneburst_phases(shot: Shot, stored: StoredRun, placement: Placement) -> ToneburstPhases | None:
    """Return the phases of the tonebursts that the second input recorded; None if it did not.

    ``placement``: pulse of each record.
    """
    tone, train = shot.toneburst, shot.burst_train
    if tone is None or train is None or not _records_tonebursts(shot):
        return None
    phasor, purity, damaged = _carrier_phasors(shot, stored, tone.carrier_hz)
    is_pure = (purity > MIN_PURITY) & (placement.pulse >= 0)
    largest = float(np.max(np.abs(phasor[is_pure]), initial=0.0))
    record = np.flatnonzero(is_pure & (np.abs(phasor) > MIN_AMPLITUDE * largest))
    pulse = placement.pulse[record]
    _, start_s = _nearest_tonebursts(shot, pulse)
    nominal_rad = 2 * np.pi * tone.carrier_hz * start_s
    return ToneburstPhases(
        pulse=pulse.astype(np.float64),
        phase_rad=np.angle(phasor[record] * np.exp(-1j * nominal_rad)),
        expected=within_tonebursts(shot).size,
        pulse_rate_hz=shot.tracking_train.rate_hz,
        burst_rate_hz=train.rate_hz,
        carrier_hz=tone.carrier_hz,
        sample_rate_hz=shot.capture.sample_rate_hz,
        damaged=damaged,
    )


def _carrier_phasors(shot: Shot, stored: StoredRun, carrier_hz: float) -> tuple[ComplexArray, FloatArray, int]:
    """Return the phasor of the carrier in each record of the second input, and its part of the energy, (record,).

    The energy of damaged records counts as 0; the third value is their number.
    """
    records, samples = stored.records.shape[1:]
    angle_rad = 2 * np.pi * carrier_hz * np.arange(samples) / shot.capture.sample_rate_hz
    columns = np.stack([np.cos(angle_rad), -np.sin(angle_rad)], axis=1)
    # Columns without a mean are blind to the input's offset.
    columns = (columns - columns.mean(axis=0)).astype(np.float32)
    phasor, purity, damaged_count = np.zeros(records, np.complex128), np.zeros(records), 0
    for first, codes, damaged in stored.records.blocks(shot.index, max(1, BLOCK_SAMPLES // samples), "monitor"):
        block, statistics = slice(first, first + len(codes)), code_statistics(codes)
        components = codes.astype(np.float32) @ columns
        phasor[block] = components[:, 0] + 1j * components[:, 1]
        # Rounding has a variance of 1/12 code²; without it constant codes would have no energy.
        energy = samples * (np.maximum(statistics.mean_square - statistics.mean**2, 0.0) + 1 / 12)
        purity[block] = np.where(damaged, 0.0, 2 / samples * np.abs(phasor[block]) ** 2 / energy)
        damaged_count += int(damaged.sum())
    return phasor, purity, damaged_count
