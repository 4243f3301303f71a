"""Model of vibrations at several places with what is not known of them: the least-squares problem of an inversion.

Measured and modelled at place p and frequency n, in complex amplitudes of sin(w t + phase):

    y_pn = g_p S_n exp(-j w_n tau) U(w_n, r_p, z_p; mu, A_p, B) + noise,    |S_n| = 2 sinc(n f_r T_b)

S the spectrum of the tonebursts, U the displacement per body force of ``shear_field.py``. The medium's parameters and
the overall amplitude are free. The widths of the force, its onset tau, and at every place its distance from the axis,
the gain g_p and what speckle does to the tracked area A_p are known with an uncertainty of their own: each is a
parameter with one more datum. docs/theory/moduli.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from hpe_rig.arrays import BoolArray, ComplexArray, FloatArray
from hpe_rig.medium import QUICK_ERROR, Law, PushForce, shear_motion

TRAVELS, TRAVEL_UNCERTAINTY = 0.5, 0.5
"""Of the way from the focus to another depth, how much the force's onset travels with the sound, 0 to 1: a force that
is long against the shear wave's way goes with it, one that acts everywhere at once does not."""
FARTHEST_M = 20e-3
"""Distance from the axis to which the field has been compared with independent ones."""
HIDDEN = 0.1
"""Of a datum's standard deviation, what no search for a minimum needs to resolve."""


@dataclass(frozen=True, slots=True)
class Push:
    """The force of the tonebursts, and relative uncertainties of its widths (across, along).

    ``onset_uncertainty_s`` is that of the bursts' onset at the focus, against which the phases count;
    ``shape_relative`` what nothing else explains of each amplitude, relative, and of its phase, rad.
    """

    force: PushForce
    burst_rate_hz: float
    burst_length_s: float
    density_kg_per_m3: float = 1000.0
    width_uncertainty: tuple[float, float] = (0.05, 0.05)
    onset_uncertainty_s: float = 0.5e-6
    shape_relative: float = 0.0

    def spectrum(self, frequency_hz: FloatArray) -> ComplexArray:
        """Return the amplitude of sin(wt + phase) of a unit force that is on during every burst, (frequency,)."""
        duty = frequency_hz * self.burst_length_s
        share = self.burst_rate_hz * self.burst_length_s
        return np.asarray(2j * share * np.sinc(duty) * np.exp(-1j * np.pi * duty))


@dataclass(frozen=True, slots=True)
class Vibration:
    """What was measured at one place: complex amplitudes A exp(j phase) (frequency,), m, of A sin(2 pi f t + phase).

    ``covariance_m2`` (2 * frequency, 2 * frequency) of A cos(phase) and A sin(phase), in turn by frequency; time counts
    from the onset of a burst at the focus. ``lateral_m`` and ``axial_m``: the place from the axis and the focus of the
    push. ``tracking_m2``: variances (across, along) of the depth and the distance that the tracking averages over.
    What is known of this place only within an uncertainty: its distance from the axis, by speckle and, alike at all
    depths of the same ``place``, by ``place_uncertainty_m``; by speckle its depth; its gain and phase common to all
    frequencies; and the averaged area across (``area_uncertainty``, relative), by which speckle changes the motion.
    ``travel_s``: how much later than at the focus sound is there; time counts from the onset there.
    """

    label: str
    frequency_hz: FloatArray
    phasor_m: ComplexArray
    covariance_m2: FloatArray
    lateral_m: float
    axial_m: float = 0.0
    tracking_m2: tuple[float, float] = (0.0, 0.0)
    lateral_uncertainty_m: float = 0.0
    place: str = ""
    place_uncertainty_m: float = 0.0
    travel_s: float = 0.0
    axial_uncertainty_m: float = 0.0
    gain_uncertainty: float = 0.0
    phase_uncertainty_rad: float = 0.0
    area_uncertainty: float = 0.0

    def only(self, kept: BoolArray) -> Vibration:
        """Return the vibration at the ``kept`` (frequency,) frequencies."""
        both = np.repeat(kept, 2)
        covariance = self.covariance_m2[np.ix_(both, both)]
        return replace(
            self, frequency_hz=self.frequency_hz[kept], phasor_m=self.phasor_m[kept], covariance_m2=covariance
        )


@dataclass(frozen=True, eq=False)
class Problem:
    """The least-squares problem: whitened data, and which of the nuisances have an uncertainty.

    The unknowns are the law's coordinates, the logarithm of the amplitude, then the nuisances in units of their
    uncertainties, which are data of their own: zero within one.
    """

    vibrations: tuple[Vibration, ...]
    push: Push
    law: Law
    whitening: tuple[FloatArray, ...]
    """The inverse of the covariance's Cholesky factor, a place."""
    nuisances: tuple[tuple[str, int, float], ...]
    """Kind, place (-1: all), uncertainty."""
    unit_m: float
    """Typical amplitude, at which the logarithm of the amplitude is 0."""
    quick: bool = False
    """Whether the field is good to ``QUICK_ERROR`` alone: to look for minima by, not to find them."""

    @staticmethod
    def of(vibrations: Sequence[Vibration], push: Push, law: Law) -> Problem:
        """Return the problem of explaining ``vibrations`` by ``law``."""
        if not vibrations:
            raise ValueError("no place has a vibration to explain")
        if far := [one.label for one in vibrations if abs(one.lateral_m) > FARTHEST_M]:
            raise ValueError(
                f"{', '.join(far)}: the field is tested to {FARTHEST_M * 1e3:g} mm from the axis; try nearer places"
            )
        known = [("across", -1, push.width_uncertainty[0]), ("along", -1, push.width_uncertainty[1])]
        known.append(("onset", -1, push.onset_uncertainty_s))
        known += [(name, -1, 1.0) for name, _ in push.force.unsure]
        leader = _leaders(vibrations)
        if any(one.travel_s for one in vibrations):
            known.append(("travel", -1, TRAVEL_UNCERTAINTY))
        for place, one in enumerate(vibrations):
            # alone, a place needs no unknown of its own besides what speckle does there
            alone = leader.count(leader[place]) == 1
            if leader[place] == place and not alone:
                known.append(("stage", place, one.place_uncertainty_m))
            known += [
                ("lateral", place, float(np.hypot(one.lateral_uncertainty_m, one.place_uncertainty_m * alone))),
                ("axial", place, one.axial_uncertainty_m),
                ("gain", place, one.gain_uncertainty),
                ("phase", place, one.phase_uncertainty_rad),
                ("area", place, one.area_uncertainty),
                ("shape", place, one.area_uncertainty),
            ]
        whitening = tuple(np.linalg.inv(np.linalg.cholesky(_covariance(one, push))) for one in vibrations)
        unit_m = float(np.sqrt(np.mean(np.concatenate([np.abs(one.phasor_m) ** 2 for one in vibrations]))))
        return Problem(tuple(vibrations), push, law, whitening, tuple(one for one in known if one[2] > 0), unit_m)

    def quickened(self) -> Problem:
        """Return the problem by the quick field, as long as the noise hides what that is off; else itself."""
        peak_m = max(float(np.abs(one.phasor_m).max()) for one in self.vibrations)
        least_m = min(float(np.sqrt(np.diag(one.covariance_m2).min())) for one in self.vibrations)
        return replace(self, quick=QUICK_ERROR * peak_m < HIDDEN * least_m)

    @cached_property
    def data_count(self) -> int:
        """How many real numbers were measured."""
        return sum(2 * one.frequency_hz.size for one in self.vibrations)

    @cached_property
    def free(self) -> int:
        """How many unknowns nothing is known of: the law's parameters and the amplitude."""
        return len(self.law.parameters) + 1

    def start(self, coordinates: FloatArray) -> tuple[FloatArray, float]:
        """Return the unknowns at the law's ``coordinates``, the amplitude the best, all else as known beforehand.

        And their chi-square.
        """
        unknown = np.zeros(self.free + len(self.nuisances))
        unknown[: self.free - 1] = coordinates
        model, data = self.whitened(self.modelled(unknown)), self.whitened([v.phasor_m for v in self.vibrations])
        ratio, size = float(model @ data) / float(model @ model), float(np.sqrt((data @ data) / (model @ model)))
        best = max(ratio, 1e-6 * size)
        unknown[self.free - 1] = np.log(best)
        return unknown, float(np.sum((data - best * model) ** 2))

    def whitened(self, phasors_m: Sequence[ComplexArray]) -> FloatArray:
        """Return all phasors as real numbers of unit variance."""
        pairs = zip(self.whitening, phasors_m, strict=True)
        return np.concatenate([root @ np.stack([y.real, y.imag], axis=-1).ravel() for root, y in pairs])

    def modelled(self, unknown: FloatArray) -> list[ComplexArray]:
        """Return the modelled phasors (frequency,) of every place."""
        return [value for value, _ in self._places(unknown.tobytes())]

    def residual(self, unknown: FloatArray) -> FloatArray:
        """Return data and what is known of the nuisances, minus the model, in standard deviations."""
        off = [one.phasor_m - value for one, value in zip(self.vibrations, self.modelled(unknown), strict=True)]
        return np.concatenate([self.whitened(off), -unknown[self.free :]])

    def jacobian(self, unknown: FloatArray) -> FloatArray:
        """Return the derivatives of ``residual`` by the unknowns."""
        blocks = [
            root @ np.stack([slopes.real, slopes.imag], axis=1).reshape(-1, unknown.size)
            for root, (_, slopes) in zip(self.whitening, self._places(unknown.tobytes()), strict=True)
        ]
        known = np.hstack([np.zeros((len(self.nuisances), self.free)), np.eye(len(self.nuisances))])
        return -np.vstack([*blocks, known])

    def covariance(self, unknown: FloatArray) -> FloatArray:
        """Return the covariance of the law's parameter values, (parameter, parameter)."""
        return self.in_values(unknown, self.coordinate_covariance(self.jacobian(unknown)))

    def coordinate_covariance(self, jacobian: FloatArray) -> FloatArray:
        count = self.free - 1
        # Scaled to unit columns: parameters of very unlike sensitivity lose no digits.
        scale = np.maximum(np.linalg.norm(jacobian, axis=0), np.finfo(np.float64).tiny)
        root = np.linalg.pinv(jacobian / scale)
        return np.asarray((root @ root.T / np.outer(scale, scale))[:count, :count])

    def in_values(self, unknown: FloatArray, covariance: FloatArray) -> FloatArray:
        slope = self.law.slopes(self.law.values(unknown[: self.free - 1]))
        return np.asarray(covariance * np.outer(slope, slope))

    def variances_without(self, dropped: BoolArray, jacobian: FloatArray) -> FloatArray:
        """Return the coordinates' variances (parameter,) without the ``dropped`` data (place and frequency,)."""
        kept = np.concatenate([~np.repeat(dropped, 2), np.ones(len(self.nuisances), bool)])
        return np.asarray(np.diag(self.coordinate_covariance(jacobian[kept])))

    @lru_cache(maxsize=2)  # noqa: B019 (of a few problems: a solver asks for residual and slopes in turn)
    def _places(self, unknowns: bytes) -> list[tuple[ComplexArray, ComplexArray]]:
        """Return the modelled phasors (frequency,) and their derivatives (frequency, unknown) of every place."""
        unknown = np.frombuffer(unknowns)
        known = {(kind, place): sigma * unknown[self.free + i] for i, (kind, place, sigma) in enumerate(self.nuisances)}
        found: dict[int, tuple[ComplexArray, ComplexArray]] = {}
        for places in self.alike:
            columns = self._columns(unknown, known, places)
            for index, place in enumerate(places):
                here = {kind: each[:, index] for kind, each in columns.items()}
                found[place] = here["gain"], self._slopes(here, unknown.size, place)
        return [found[place] for place in range(len(self.vibrations))]

    def _columns(
        self, unknown: FloatArray, known: dict[tuple[str, int], float], places: tuple[int, ...]
    ) -> dict[str, ComplexArray]:
        """Return the phasors' derivatives (frequency, place) by every kind of unknown; by "gain", the phasors."""
        push, count, ones = self.push, self.free - 1, [self.vibrations[place] for place in places]
        stretched = (float(np.exp(known.get((kind, -1), 0.0))) for kind in ("across", "along"))
        mean_area = np.array([one.tracking_m2[0] for one in ones])
        # by its logarithm: no step of a solver asks for an area below none
        area = mean_area * np.exp([known.get(("area", p), 0.0) for p in places])
        off = [known.get(("lateral", p), 0.0) + known.get(("stage", self.leaders[p]), 0.0) for p in places]
        lateral = np.array([one.lateral_m for one in ones]) + off
        own = np.array([known.get(("gain", p), 0.0) + 1j * known.get(("phase", p), 0.0) for p in places])
        frequency_hz = ones[0].frequency_hz
        omega, values = 2 * np.pi * frequency_hz, self.law.values(unknown[:count])
        modulus, by_values = self.law.modulus(np.asarray(1j * omega, np.complex128), values)
        field = shear_motion(
            modulus,
            frequency_hz,
            push.density_kg_per_m3,
            push.force.changed({kind: off for (kind, _), off in known.items()}).scaled(*stretched),
            area,
            ones[0].tracking_m2[1],
            lateral,
            ones[0].axial_m,
            self.quick,
        )
        onset = np.exp(-1j * omega * known.get(("onset", -1), 0.0))
        # the force's peak is free: what counts is how the field's amplitude hangs on frequency and place
        scale = self.unit_m / self._unit_field * np.exp(unknown[count] + own)
        # what of the way to a depth the force has not travelled with the sound: s = 1 for a force that goes with it
        late_s = ones[0].travel_s * (1 - TRAVELS - known.get(("travel", -1), 0.0))
        front = (push.spectrum(frequency_hz) * onset * np.exp(1j * omega * late_s))[:, None] * scale
        # Speckle's second mode: the weight at the middle and at the edge against that in between, of the same area.
        shape = np.array([known.get(("shape", p), 0.0) for p in places])
        bent = front * field.by_across_twice * mean_area**2 / 2
        deeper = np.array([known.get(("axial", p), 0.0) for p in places])
        value = front * (field.value + deeper * field.by_axial) + shape * bent
        by_law = by_values * self.law.slopes(values)
        return {
            "gain": value,
            "phase": 1j * value,
            "onset": -1j * omega[:, None] * value,
            "across": front * field.by_width,
            "along": front * field.by_length,
            **{kind: front * slopes for kind, slopes in field.by_unsure.items()},
            "travel": -1j * omega[:, None] * ones[0].travel_s * value,
            "axial": front * field.by_axial,
            "lateral": front * field.by_lateral,
            "stage": front * field.by_lateral,
            "area": front * field.by_across * area,
            "shape": bent,
            **{f"law {i}": front * field.by_modulus * by_law[:, i, None] for i in range(count)},
        }

    def _slopes(self, here: dict[str, ComplexArray], unknowns: int, place: int) -> ComplexArray:
        """Return the derivatives (frequency, unknown) of the phasors at ``place``, of which ``here`` has every kind."""
        columns = np.zeros((here["gain"].size, unknowns), np.complex128)
        for i in range(self.free - 1):
            columns[:, i] = here[f"law {i}"]
        columns[:, self.free - 1] = here["gain"]
        for i, (kind, where, sigma) in enumerate(self.nuisances):
            if where in (-1, place) or (kind == "stage" and where == self.leaders[place]):
                columns[:, self.free + i] = sigma * here[kind]
        return columns

    @cached_property
    def alike(self) -> tuple[tuple[int, ...], ...]:
        """Places of the same frequencies, depth and averaging along the beam, whose fields are computed at once."""
        groups: dict[tuple[object, ...], list[int]] = {}
        for place, one in enumerate(self.vibrations):
            key = one.frequency_hz.tobytes(), one.axial_m, one.tracking_m2[1], one.travel_s
            groups.setdefault(key, []).append(place)
        return tuple(tuple(each) for each in groups.values())

    @cached_property
    def leaders(self) -> tuple[int, ...]:
        """Of every vibration the first at the same place."""
        return _leaders(self.vibrations)

    @cached_property
    def _unit_field(self) -> float:
        """A typical displacement per body force: that of a static force in 10 kPa."""
        return 0.5 * self.push.force.across_m[0] ** 2 / 10e3


def _covariance(one: Vibration, push: Push) -> FloatArray:
    """Return the covariance of noise and of what the force's shape leaves unexplained."""
    unexplained_m = push.shape_relative * np.repeat(np.abs(one.phasor_m), 2)
    return np.asarray(one.covariance_m2 + np.diag(unexplained_m**2))


def _leaders(vibrations: Sequence[Vibration]) -> tuple[int, ...]:
    """Return of every vibration the first at the same place; itself where it names none."""
    first: dict[str, int] = {}
    return tuple(first.setdefault(one.place, index) if one.place else index for index, one in enumerate(vibrations))
