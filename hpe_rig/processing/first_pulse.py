"""Which tracking pulse came first: evidence for the pulse of each record where trigger times leave it open.

Records of pulses near a toneburst are disturbed: the toneburst leaks into them, or its echo does. The plan knows which
pulses these are, so the disturbed records of a shot show by how many pulses its records are shifted. The second input
is preferred to the echoes: on a T piece at the output of the toneburst generator it records the toneburst itself.

The *shift* of a record is the number of its pulse minus the number that the trigger times give it. It is 2, for
example, if the first two triggers of a train were lost, so that record 1 is that of pulse 3.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from hpe_rig.arrays import BoolArray, FloatArray, Int64Array
from hpe_rig.plan import CLEAN, INSIDE, NEAR, Shot, pulse_kinds
from hpe_rig.processing.echo.conditioning import code_statistics, concatenate_statistics, deviating_levels
from hpe_rig.processing.echo.gate import BLOCK_SAMPLES

if TYPE_CHECKING:
    from hpe_rig.store import Placement, StoredRun

START_RATES: Final = (0.005, 0.5, 0.95)
"""Assumed fraction of disturbed records by kind of pulse (clean, near, inside); replaced by the observed fractions."""
MIN_EVIDENCE: Final = 12.0
"""Logarithm of the likelihood ratio above which disturbed records follow the tonebursts, and not chance."""
MIN_RATIO: Final = 7.0
"""Logarithm of the likelihood ratio above which the less likely of two explanations is excluded."""
CHANGE: Final = -14.0
"""Assumed logarithm of the probability of a lost or stray trigger at any one record."""
JUMP_CHANGE: Final = 0.05
"""Assumed probability that a trigger was lost at a jump of the trigger times: one disturbance often causes both."""
MAX_STRAY: Final = 3
"""Number of stray triggers that are considered if there are no trigger times."""
MAX_ALTERNATIVES: Final = 6
"""Number of possible first pulses for which a shot is estimated, in addition to the assigned one."""
MAX_TERMS: Final = 20_000_000
"""Number of records times shifts above which evidence is not evaluated."""
MAX_DOUBT: Final = 1e-3
"""Probability of another pulse above which a record is left out."""


@dataclass(frozen=True, slots=True)
class PulseAssignment:
    """The pulses of the records of a shot, and what remains unknown about them.

    ``placement``: the assigned pulse of each record. ``shifts``: possible shifts of all records relative to it, equally
    likely; (0,) if the assignment is certain. ``within_shot``: the shift may begin at any record. ``remarks``:
    sentences on lost and stray triggers.
    """

    placement: Placement
    shifts: tuple[int, ...] = (0,)
    within_shot: bool = False
    remarks: tuple[str, ...] = ()

    def alternatives_s(self, shot: Shot) -> list[float]:
        """Return the possible delays of all records relative to ``placement``, s; at most ``MAX_ALTERNATIVES``."""
        shifts = np.array(self.shifts[1:])
        selected = np.unique(np.linspace(0, shifts.size - 1, MAX_ALTERNATIVES).round().astype(np.int64))
        return [float(shift) / shot.tracking_train.rate_hz for shift in shifts[selected]]

    def late_part_s(self, shot: Shot) -> float:
        """Return how late, s, the records of a later part of the shot may be at most, while the first ones are not."""
        return max(self.shifts) / shot.tracking_train.rate_hz if self.within_shot else 0.0


def assign_pulses(shot: Shot, stored: StoredRun) -> PulseAssignment:
    """Return the pulse of each record of ``shot``, by trigger times and, where these leave it open, by tonebursts.

    The digitizer takes as many records as the train has pulses, one for each trigger. Fewer records show that triggers
    were lost. With all records none was lost, unless the digitizer also took records at stray triggers: it then stopped
    before the train ended, and the pulses without a record are assumed to be the last ones. In a shot that was not
    completed, missing records at the end are no sign of lost triggers.
    """
    # The assignment by trigger times. ``delivered`` (record,): the record arrived. ``loose`` (record,): its pulse is
    # counted from the record before, not measured. ``unlocated``: number of pulses that have no record and may come
    # before the first record or after the last.
    placement = stored.records.placement(shot.index)
    assignment = PulseAssignment(placement, remarks=tuple(_time_remarks(placement)))
    # No record has a usable trigger time.
    timeless = bool(placement.delivered.any() and placement.loose[placement.delivered].all())
    is_certain = stored.imported or not stored.shot_complete[shot.index]
    if is_certain or not (placement.unlocated or timeless):
        return assignment
    # Records disturbed by tonebursts: at the second input, or else in the echoes.
    kinds = pulse_kinds(shot)
    for name in ("monitor", "echo") if kinds.any() else ():
        disturbed = _disturbed_records(shot, stored, name, placement.delivered)
        corrected = None if disturbed is None else _by_tonebursts(assignment, kinds, disturbed, timeless)
        if corrected is not None:
            return corrected
    # No evidence: from none to all of the missing pulses may have come before the first record. All records are then
    # those of pulses later by that number, their shift. With counted records a shift may also begin within the shot.
    missing = 0 if placement.delivered.all() else placement.unlocated
    possible_shifts = tuple(range(missing + 1))
    return replace(assignment, shifts=possible_shifts, within_shot=bool(missing and placement.loose.any()))


def _time_remarks(placement: Placement) -> list[str]:
    """Return a sentence for each fault of the triggers that the trigger times reveal."""
    remarks = [f"{remark}: later records are assigned to pulses by counting from there" for remark in placement.remarks]
    if placement.stray:
        numbers = ", ".join(str(record + 1) for record in placement.stray[:5])
        more = ", ..." if len(placement.stray) > 5 else ""
        remarks.append(
            f"{len(placement.stray)} records come from stray triggers between the pulses (record {numbers}{more}) and "
            "are left out: check the trigger cable and digitizer.trigger_level_v"
        )
    return remarks


def _disturbed_records(shot: Shot, stored: StoredRun, name: str, delivered: BoolArray) -> BoolArray | None:
    """Return which of the ``delivered`` records (record,) of an input have an energy unlike that of the others.

    ``name``: the input, "echo" or "monitor". None if it was not recorded or is damaged.
    """
    from hpe_rig.store import StoreError

    if name == "monitor" and shot.capture.monitor_range_v is None:
        return None
    step = max(1, BLOCK_SAMPLES // stored.records.shape[2])
    try:
        blocks = stored.records.chunks(shot.index, step, name)
        statistics = concatenate_statistics([code_statistics(codes) for _, codes in blocks])
    except StoreError:
        return None
    # Rounding has a variance of 1/12 code²; without it, constant codes would have an infinite level.
    variance = np.maximum(statistics.mean_square - statistics.mean**2, 0.0) + 1 / 12
    disturbed = np.zeros_like(delivered)
    disturbed[delivered] = deviating_levels(np.log(variance[delivered]))
    return disturbed


def _by_tonebursts(
    assignment: PulseAssignment, kinds: Int64Array, disturbed: BoolArray, timeless: bool
) -> PulseAssignment | None:
    """Return ``assignment`` with the pulses corrected by the tonebursts, which disturb the records near them.

    The shift of a record is the number of pulses by which its assigned pulse is wrong. ``kinds`` (pulse,): whether a
    pulse is ``CLEAN`` of tonebursts, ``NEAR`` or ``INSIDE`` one. ``disturbed`` (record,): the record's energy deviates.
    ``timeless``: no record has a usable trigger time, so stray triggers are possible. None if no shift fits.
    """
    placement = assignment.placement
    records = np.flatnonzero(placement.pulse >= 0)
    # Lost triggers shift records to later pulses, stray triggers to earlier ones: the shifts to be compared. The pulses
    # ``unlocated`` have no record and may come before the first record or after the last.
    strays = MAX_STRAY if timeless else 0
    shifts = np.arange(-strays, placement.unlocated + strays + 1)
    if records.size * shifts.size > MAX_TERMS:
        return None
    # Kinds (record, shift) of the pulses that the records would have; -1 outside the train, which has no records.
    padded = np.concatenate([np.full(shifts.size, -1), kinds, np.full(shifts.size, -1)])
    shifted_kinds = padded[placement.pulse[records][:, None] + shifts + shifts.size]
    # The shift may change at ``loose`` records: their pulses are counted from the record before, not measured.
    changes = placement.loose[records] & (np.arange(records.size) > 0)
    log_change = CHANGE if timeless else float(np.log(JUMP_CHANGE / max(1, int(changes.sum()))))
    log_changes = np.where(changes, log_change, -np.inf)
    posterior, evidence = _posterior(shifted_kinds, disturbed[records], log_changes)
    # A jump of the trigger times by whole periods can hide a lost trigger: then the tonebursts contradict the times.
    # This is the case if changes of the shift at any record explain the disturbances far better.
    log_changes_anywhere = np.maximum(log_changes, CHANGE)
    posterior_anywhere, evidence_anywhere = _posterior(shifted_kinds, disturbed[records], log_changes_anywhere)
    is_hidden = evidence_anywhere > evidence + MIN_RATIO
    if is_hidden:
        posterior, evidence = posterior_anywhere, evidence_anywhere
    if evidence < MIN_EVIDENCE:
        return None
    if not (changes.any() or is_hidden):
        return _with_common_shift(assignment, shifts, posterior[0])
    return _with_shifts(assignment, records, shifts, posterior)


def _posterior(kinds: Int64Array, disturbed: BoolArray, log_changes: FloatArray) -> tuple[FloatArray, float]:
    """Return the probability (record, shift) that a record's pulse number is wrong by each shift, and the evidence.

    The evidence is the log likelihood minus that of disturbances independent of the tonebursts. ``kinds`` (record,
    shift): kind of the pulse that the record would have, -1 outside the train. ``disturbed`` (record,): the record's
    energy deviates. ``log_changes`` (record,): log probability that the shift changes at the record.
    """
    # A hidden Markov model whose states are the shifts. Three rounds of expectation maximization also estimate
    # ``rates``, the fraction of disturbed records by kind of pulse.
    rates = np.array(START_RATES)
    for _ in range(3):
        # Log probability of an undisturbed and of a disturbed record, by kind of its pulse.
        log_rates = np.log(np.stack([1 - rates, rates]))
        log_likelihood = np.where(kinds < 0, -np.inf, log_rates[disturbed.astype(np.int64)[:, None], kinds])
        posterior, total = _forward_backward(log_likelihood, log_changes)
        # Probability that a record is of each kind, (record,).
        of_kind = [np.where(kinds == kind, posterior, 0.0).sum(axis=1) for kind in (CLEAN, NEAR, INSIDE)]
        # Half a disturbed and half an undisturbed record are added, so that no rate becomes 0 or 1.
        rates = np.array([(weight[disturbed].sum() + 0.5) / (weight.sum() + 1.0) for weight in of_kind])
        # Pulses nearer to a toneburst are disturbed at least as often.
        rates = np.maximum.accumulate(rates)
    fraction = (disturbed.sum() + 0.5) / (disturbed.size + 1)
    chance = np.log(np.where(disturbed, fraction, 1 - fraction)).sum()
    return posterior, float(total - chance)


def _forward_backward(log_likelihood: FloatArray, log_changes: FloatArray) -> tuple[FloatArray, float]:
    """Return the posterior (record, state) of a chain that rarely changes its state, and the data's log likelihood.

    Here a state is a shift. ``log_likelihood`` (record, state): of each single record. ``log_changes`` (record,): log
    probability of a change at each. Computed by the forward-backward algorithm of hidden Markov models.
    """
    records, states = log_likelihood.shape
    # Records without a change in between share one state: they are one block, with the sum of their log likelihoods.
    start = np.flatnonzero(np.concatenate([[True], np.isfinite(log_changes[1:])]))
    block = np.add.reduceat(log_likelihood, start, axis=0)
    # Log probabilities of the records up to each block (forward) and after it (backward), for each state.
    forward, backward = np.empty_like(block), np.zeros_like(block)
    forward[0] = block[0] - np.log(states)
    for index in range(1, start.size):
        forward[index] = _after_possible_change(forward[index - 1], log_changes[start[index]]) + block[index]
    for index in range(start.size - 2, -1, -1):
        later = backward[index + 1] + block[index + 1]
        backward[index] = _after_possible_change(later, log_changes[start[index + 1]])
    joint = forward + backward
    total = float(np.logaddexp.reduce(forward[-1]))
    posterior = np.exp(joint - np.logaddexp.reduce(joint, axis=1, keepdims=True))
    by_record: FloatArray = np.repeat(posterior, np.diff(np.append(start, records)), axis=0)
    return by_record, total


def _after_possible_change(log_probability: FloatArray, log_change: float) -> FloatArray:
    """Return log probabilities (state,) after a possible change of state, of probability exp(``log_change``)."""
    changed = np.logaddexp.reduce(log_probability) + log_change - np.log(log_probability.size)
    return np.asarray(np.logaddexp(log_probability, changed))


def _with_common_shift(assignment: PulseAssignment, shifts: Int64Array, posterior: FloatArray) -> PulseAssignment:
    """Return the assignment with one shift of all records, given the ``posterior`` probability (shift,) of ``shifts``.

    The first of the shifts that are not excluded is used; the others remain as possible further shifts.
    """
    possible = shifts[posterior > posterior.max() * np.exp(-MIN_RATIO)]
    used = int(possible[0])
    placement = assignment.placement.shifted(np.full(assignment.placement.pulse.size, used))
    remarks = assignment.remarks
    if used:
        remarks += (_lost_first(used),)
    return replace(assignment, placement=placement, shifts=tuple((possible - used).tolist()), remarks=remarks)


def _with_shifts(
    assignment: PulseAssignment, records: Int64Array, shifts: Int64Array, posterior: FloatArray
) -> PulseAssignment | None:
    """Return ``assignment`` with the pulse of every record moved by its most probable shift, in pulses.

    A shift changes within the shot where triggers were lost or stray. ``records`` (record,): numbers of the records
    that have a pulse. ``posterior`` (record, shift): probability of each of ``shifts`` (shift,) at each of them. None
    if no shift is certain at any record.
    """
    best = posterior.argmax(axis=1)
    certain = posterior.max(axis=1) > 1 - MAX_DOUBT
    if not certain.any():
        return None
    # Records of an uncertain pulse, and records that would share a pulse, get none.
    placement = assignment.placement
    pulse = np.where(certain, placement.pulse[records] + shifts[best], -1)
    repeated = np.isin(pulse, np.flatnonzero(np.bincount(pulse[pulse >= 0]) > 1))
    pulse_of_record = placement.pulse.copy()
    pulse_of_record[records] = np.where(repeated, -1, pulse)
    # Where the shift changes, the number of pulses since the record before is not measured.
    loose = placement.loose.copy()
    loose[records[certain][1:][np.diff(shifts[best[certain]]) != 0]] = True
    # A sentence for each change of the shift between certain records, and for one that the records start with.
    certain_shifts, certain_records = shifts[best[certain]], records[certain]
    remarks = assignment.remarks
    for index in np.flatnonzero(np.diff(certain_shifts)):
        before, after = certain_shifts[index : index + 2]
        fault = f"{triggers(after - before)} lost" if after > before else f"{triggers(before - after)} too many"
        first, last = certain_records[index : index + 2] + 1
        remarks += (
            f"{fault} between record {first} and {last}: the tonebursts in the records show it, and the records "
            "between these are left out",
        )
    if (first_shift := int(certain_shifts[0])) > 0:
        first = int(certain_records[0])
        remarks += (_lost_first(first_shift) if first == records[0] else _lost_before(first_shift, first + 1),)
    return replace(assignment, placement=replace(placement, pulse=pulse_of_record, loose=loose), remarks=remarks)


def _lost_first(count: int) -> str:
    """Return the remark that the first ``count`` triggers of a shot were lost."""
    subject = "trigger was" if count == 1 else f"{count} triggers were"
    return f"the first {subject} lost: the tonebursts in the records show it"


def _lost_before(count: int, record: int) -> str:
    """Return the remark that ``count`` triggers were lost at unknown places before ``record``, counted from 1."""
    return (
        f"{triggers(count)} lost before record {record}: the tonebursts in the records from it on show it, "
        "and the records before it are left out"
    )


def triggers(count: int) -> str:
    """Return the subject of a remark about ``count`` triggers."""
    return "a trigger was" if count == 1 else f"{count} triggers were"
