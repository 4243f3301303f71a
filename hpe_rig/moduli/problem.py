"""The least-squares problem of an inversion: whitened data, modelled vibrations and their derivatives.

    minimise  sum |L^-1 (y - y_model(x))|^2 + sum_k n_k^2,    x = (coordinates of the law, ln amplitude, n_1, n_2, ...)

L is the Cholesky factor of the data covariance. The medium's parameters and the common amplitude are free. Every
nuisance n_k, in units of its standard uncertainty, is an unknown with one more datum: zero within one. The covariance
of the moduli so includes the uncertainty of widths, positions and gains. Derivation: docs/explanation/moduli.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from hpe_rig.arrays import BoolArray, ComplexArray, FloatArray
from hpe_rig.medium import QUICK_ERROR, HarmonicMedium, Law, TrackedRegion, shear_motion
from hpe_rig.moduli.vibration_model import Push, Vibration

TRAVEL_FRACTION, TRAVEL_FRACTION_UNCERTAINTY = 0.5, 0.5
"""Delay of the force's onset at another depth over the sound's travel time from the focus, 0 to 1.

A force much longer than the shear wave's path travels with the sound (1); one that acts everywhere at once does not
(0).
"""
MAX_LATERAL_M = 20e-3
"""Distance from the axis up to which the field has been compared with independent ones."""
NEGLIGIBLE_ERROR = 0.1
"""Error of a datum, in standard deviations, that does not matter for the search of minima."""
COMMON = -1
"""Index of a nuisance that all vibrations share."""


class Nuisance(NamedTuple):
    """An unknown of known standard uncertainty; ``vibration`` is an index, or ``COMMON``."""

    kind: str
    vibration: int
    uncertainty: float


@dataclass(frozen=True, eq=False)
class Problem:
    """Explain ``vibrations`` under ``push`` by the material law ``law``.

    ``whitening``: inverse Cholesky factors of the covariances, one a vibration. ``nuisances``: unknowns that are not
    wanted, of known uncertainty. ``unit_m``: amplitude with the unknown ln amplitude 0. ``quick``: use the quick field,
    which is accurate to ``QUICK_ERROR``.
    """

    vibrations: tuple[Vibration, ...]
    push: Push
    law: Law
    whitening: tuple[FloatArray, ...]
    nuisances: tuple[Nuisance, ...]
    unit_m: float
    quick: bool = False

    @staticmethod
    def of(vibrations: Sequence[Vibration], push: Push, law: Law) -> Problem:
        """Return the least-squares problem of fitting ``law`` to ``vibrations`` under ``push``.

        Raises ``ValueError`` without vibrations, and for one farther than ``MAX_LATERAL_M`` from the axis.
        """
        if not vibrations:
            raise ValueError("there is no vibration to explain")
        if too_far := [vibration.label for vibration in vibrations if abs(vibration.lateral_m) > MAX_LATERAL_M]:
            raise ValueError(
                f"{', '.join(too_far)}: the field is tested to {MAX_LATERAL_M * 1e3:g} mm from the axis. "
                "Try: smaller lateral offsets"
            )
        # Whitened data have unit variance: chi-square is their sum of squares. ``unit_m``: typical amplitude.
        whitening = tuple(
            np.linalg.inv(np.linalg.cholesky(_data_covariance_m2(vibration, push))) for vibration in vibrations
        )
        unit_m = float(np.sqrt(np.mean(np.concatenate([np.abs(vibration.phasor_m) ** 2 for vibration in vibrations]))))
        return Problem(
            vibrations=tuple(vibrations),
            push=push,
            law=law,
            whitening=whitening,
            nuisances=_nuisances(vibrations, push),
            unit_m=unit_m,
        )

    def with_quick_field(self) -> Problem:
        """Return the problem with the faster, less exact field if noise far exceeds its error, else as it is."""
        peak_m = max(float(np.abs(vibration.phasor_m).max()) for vibration in self.vibrations)
        min_noise_m = min(float(np.sqrt(np.diag(vibration.covariance_m2).min())) for vibration in self.vibrations)
        return replace(self, quick=QUICK_ERROR * peak_m < NEGLIGIBLE_ERROR * min_noise_m)

    @cached_property
    def data_count(self) -> int:
        """Number of measured real numbers."""
        return sum(2 * vibration.frequency_hz.size for vibration in self.vibrations)

    @cached_property
    def coordinate_count(self) -> int:
        """Number of the law's coordinates, which are the first unknowns; the amplitude and the nuisances follow."""
        return len(self.law.parameters)

    @cached_property
    def free_count(self) -> int:
        """Number of unknowns without prior knowledge: the law's coordinates and the amplitude."""
        return self.coordinate_count + 1

    def start(self, coordinates: FloatArray) -> tuple[FloatArray, float]:
        """Return a start of the fit at the law's ``coordinates``, and its chi-square.

        It has the best amplitude for them; nuisances are zero, their most likely value.
        """
        unknown = np.zeros(self.free_count + len(self.nuisances))
        unknown[: self.coordinate_count] = coordinates
        # Modelled phasors for amplitude 1, in standard deviations of the data.
        model = self._whitened(self.modelled(unknown))
        data = self._whitened([vibration.phasor_m for vibration in self.vibrations])
        # The best amplitude is a projection; at least 1e-6 of the data, because its logarithm is the unknown.
        projection = float(model @ data) / float(model @ model)
        amplitude = max(projection, 1e-6 * float(np.sqrt((data @ data) / (model @ model))))
        unknown[self.coordinate_count] = np.log(amplitude)
        return unknown, float(np.sum((data - amplitude * model) ** 2))

    def modelled(self, unknown: FloatArray) -> list[ComplexArray]:
        """Return the modelled phasors (frequency,) of every vibration."""
        return [value for value, _ in self._model(unknown.tobytes())]

    def residual(self, unknown: FloatArray) -> FloatArray:
        """Return data minus model (datum,) in standard deviations, then minus each nuisance, expected to be zero."""
        pairs = zip(self.vibrations, self.modelled(unknown), strict=True)
        errors_m = [vibration.phasor_m - value for vibration, value in pairs]
        return np.concatenate([self._whitened(errors_m), -unknown[self.free_count :]])

    def jacobian(self, unknown: FloatArray) -> FloatArray:
        """Return the derivatives (datum, unknown) of ``residual`` by the unknowns."""
        # The residual is data minus model: minus the whitened derivatives of the modelled phasors. Real and imaginary
        # parts of a frequency are neighbouring rows.
        data_rows = [
            whitening @ np.stack([slopes.real, slopes.imag], axis=1).reshape(-1, unknown.size)
            for whitening, (_, slopes) in zip(self.whitening, self._model(unknown.tobytes()), strict=True)
        ]
        # Then the residual is minus each nuisance, the last unknowns.
        count = len(self.nuisances)
        nuisance_rows = np.hstack([np.zeros((count, self.free_count)), np.eye(count)])
        return -np.vstack([*data_rows, nuisance_rows])

    def coordinate_covariance(self, jacobian: FloatArray) -> FloatArray:
        """Return the covariance (parameter, parameter) of the law's coordinates; ``jacobian`` (datum, unknown)."""
        count = self.coordinate_count
        # Columns of unit length: parameters of very different sensitivity lose no digits.
        scale = np.maximum(np.linalg.norm(jacobian, axis=0), np.finfo(np.float64).tiny)
        # The covariance of all unknowns is (J'J)^-1 = root root'. Its block of the law includes the nuisances' effect.
        root = np.linalg.pinv(jacobian / scale)
        return np.asarray((root @ root.T / np.outer(scale, scale))[:count, :count])

    def in_values(self, unknown: FloatArray, covariance: FloatArray) -> FloatArray:
        """Return a ``covariance`` of coordinates as one of parameter values."""
        slope = self.law.slopes(self.law.values(unknown[: self.coordinate_count]))
        return np.asarray(covariance * np.outer(slope, slope))

    def variances_without(self, dropped: BoolArray, jacobian: FloatArray) -> FloatArray:
        """Return the coordinates' variances (parameter,) without the ``dropped`` phasors (vibration and frequency,)."""
        # Two real data a phasor; the data of the nuisances remain.
        rows = np.concatenate([~np.repeat(dropped, 2), np.ones(len(self.nuisances), bool)])
        return np.asarray(np.diag(self.coordinate_covariance(jacobian[rows])))

    def _whitened(self, phasors_m: Sequence[ComplexArray]) -> FloatArray:
        """Return all phasors as real numbers of unit variance."""
        pairs = zip(self.whitening, phasors_m, strict=True)
        return np.concatenate([root @ np.stack([y.real, y.imag], axis=-1).ravel() for root, y in pairs])

    @lru_cache(maxsize=2)  # noqa: B019 (a solver asks for residual and jacobian at the same unknowns)
    def _model(self, unknown_bytes: bytes) -> list[tuple[ComplexArray, ComplexArray]]:
        """Return the modelled phasors (frequency,) and their derivatives (frequency, unknown) of every vibration.

        ``unknown_bytes``: the unknowns, as bytes that can be a cache key.
        """
        unknown = np.frombuffer(unknown_bytes)
        # Nuisances by kind and vibration, in their own units instead of standard uncertainties.
        deviations = {
            (kind, vibration): uncertainty * unknown[self.free_count + i]
            for i, (kind, vibration, uncertainty) in enumerate(self.nuisances)
        }
        # The vibrations of a group differ in lateral offset only: they are columns of one field.
        results: dict[int, tuple[ComplexArray, ComplexArray]] = {}
        for group in self.groups_sharing_field:
            phasors_m, slopes = self._group_model(unknown, deviations, group)
            for column, vibration in enumerate(group):
                slopes_by_kind = {kind: values[:, column] for kind, values in slopes.items()}
                results[vibration] = phasors_m[:, column], self._slopes_by_unknown(slopes_by_kind, vibration)
        return [results[vibration] for vibration in range(len(self.vibrations))]

    def _group_model(
        self, unknown: FloatArray, deviations: dict[tuple[str, int], float], group: tuple[int, ...]
    ) -> tuple[ComplexArray, dict[str, ComplexArray]]:
        """Return modelled phasors (frequency, vibration), m, and their derivatives by every kind of unknown.

        ``group``: indices of vibrations that share one field; they differ in lateral offset and in their nuisances.
        ``deviations``: nuisances by kind and vibration.
        """
        push, first = self.push, self.vibrations[group[0]]
        # Medium at the law's parameters, and derivatives of its modulus by the law's coordinates.
        omega = 2 * np.pi * first.frequency_hz
        values = self.law.values(unknown[: self.coordinate_count])
        modulus_pa, modulus_by_values = self.law.modulus(np.asarray(1j * omega, np.complex128), values)
        modulus_by_coordinates = modulus_by_values * self.law.slopes(values)
        medium = HarmonicMedium(first.frequency_hz, modulus_pa, push.density_kg_per_m3)
        # Force and tracked region with their deviations. A logarithmic deviation keeps widths and area positive.
        width_factors = (float(np.exp(deviations.get((kind, COMMON), 0.0))) for kind in ("across", "along"))
        force = push.force.changed({kind: value for (kind, _), value in deviations.items()}).scaled(*width_factors)
        area_m2 = np.array([self.vibrations[i].tracking_m2[0] for i in group]) * np.exp(
            _values(deviations, "area", group)
        )
        stage_m = np.array([deviations.get(("stage", self.first_at_position[i]), 0.0) for i in group])
        deviation_m = _values(deviations, "lateral", group) + stage_m
        lateral_m = np.array([self.vibrations[i].lateral_m for i in group]) + deviation_m
        region = TrackedRegion(lateral_m, first.axial_m, across_m2=area_m2, along_m2=first.tracking_m2[1])
        field = shear_motion(medium, force, region, self.quick)
        drive = self._drive(unknown, deviations, group)
        # Speckle changes the tracked region: its area, above, and its depth.
        phasors_m = drive * (field.value + _values(deviations, "axial", group) * field.by_axial)
        return phasors_m, {
            "gain": phasors_m,
            "phase": 1j * phasors_m,
            "onset": -1j * omega[:, None] * phasors_m,
            "across": drive * field.by_width,
            "along": drive * field.by_length,
            **{kind: drive * slopes for kind, slopes in field.by_weight_change.items()},
            "travel": -1j * omega[:, None] * first.travel_s * phasors_m,
            "axial": drive * field.by_axial,
            "lateral": drive * field.by_lateral,
            "stage": drive * field.by_lateral,
            "area": drive * field.by_across * area_m2,
            **{
                f"law {i}": drive * field.by_modulus * slopes[:, None]
                for i, slopes in enumerate(modulus_by_coordinates.T)
            },
        }

    def _drive(
        self, unknown: FloatArray, deviations: dict[tuple[str, int], float], group: tuple[int, ...]
    ) -> ComplexArray:
        """Return the complex amplitude of the force (frequency, vibration) for the vibrations of ``group``."""
        push, first = self.push, self.vibrations[group[0]]
        # Gains and phases (vibration,). With ln amplitude 0 the motion is ``unit_m`` in a medium of 10 kPa, where a
        # static unit force moves the focus by half its squared width over the modulus.
        static_m = 0.5 * push.force.across_m[0] ** 2 / 10e3
        gain, phase_rad = (_values(deviations, kind, group) for kind in ("gain", "phase"))
        amplitude = self.unit_m / static_m * np.exp(unknown[self.coordinate_count] + (gain + 1j * phase_rad))
        # Spectrum of the bursts and their onset. Phases count from the sound's arrival at the gate; the force starts
        # there before that arrival.
        omega = 2 * np.pi * first.frequency_hz
        onset = np.exp(-1j * omega * deviations.get(("onset", COMMON), 0.0))
        lead_s = first.travel_s * (1 - TRAVEL_FRACTION - deviations.get(("travel", COMMON), 0.0))
        spectrum = push.spectrum(first.frequency_hz) * onset * np.exp(1j * omega * lead_s)
        return np.asarray(spectrum[:, None] * amplitude)

    def _slopes_by_unknown(self, slopes_by_kind: dict[str, ComplexArray], vibration: int) -> ComplexArray:
        """Return the derivatives (frequency, unknown) of the phasors of the vibration with index ``vibration``.

        ``slopes_by_kind``: derivatives (frequency,) by every kind of unknown.
        """
        unknown_count = self.free_count + len(self.nuisances)
        columns = np.zeros((slopes_by_kind["gain"].size, unknown_count), np.complex128)
        for i in range(self.coordinate_count):
            columns[:, i] = slopes_by_kind[f"law {i}"]
        # The logarithm of the common amplitude changes the phasors as a gain does.
        columns[:, self.coordinate_count] = slopes_by_kind["gain"]
        for i, (kind, index, uncertainty) in enumerate(self.nuisances):
            # All gates at one position move with the stage.
            shared_stage = kind == "stage" and index == self.first_at_position[vibration]
            if index in (COMMON, vibration) or shared_stage:
                columns[:, self.free_count + i] = uncertainty * slopes_by_kind[kind]
        return columns

    @cached_property
    def groups_sharing_field(self) -> tuple[tuple[int, ...], ...]:
        """Vibrations with the same frequencies, depth and averaging along the beam: one field computes them all."""
        groups: dict[tuple[object, ...], list[int]] = {}
        for index, vibration in enumerate(self.vibrations):
            key = vibration.frequency_hz.tobytes(), vibration.axial_m, vibration.tracking_m2[1], vibration.travel_s
            groups.setdefault(key, []).append(index)
        return tuple(tuple(group) for group in groups.values())

    @cached_property
    def first_at_position(self) -> tuple[int, ...]:
        """For every vibration, the index of the first one at the same position."""
        return _first_at_position(self.vibrations)


def _nuisances(vibrations: Sequence[Vibration], push: Push) -> tuple[Nuisance, ...]:
    """Return the unknowns that are not wanted but have an uncertainty: of the push, of positions, of each vibration."""
    across, along = push.width_uncertainty
    nuisances = [
        Nuisance("across", COMMON, across),
        Nuisance("along", COMMON, along),
        Nuisance("onset", COMMON, push.onset_uncertainty_s),
        *(Nuisance(name, COMMON, 1.0) for name, _ in push.force.weight_changes),
    ]
    if any(vibration.travel_s for vibration in vibrations):
        nuisances.append(Nuisance("travel", COMMON, TRAVEL_FRACTION_UNCERTAINTY))
    first = _first_at_position(vibrations)
    for index, vibration in enumerate(vibrations):
        # A single gate at a position needs no stage unknown: its lateral unknown covers both errors.
        is_single = first.count(first[index]) == 1
        if first[index] == index and not is_single:
            nuisances.append(Nuisance("stage", index, vibration.stage_uncertainty_m))
        lateral_m = float(np.hypot(vibration.lateral_uncertainty_m, vibration.stage_uncertainty_m * is_single))
        nuisances += [
            Nuisance("lateral", index, lateral_m),
            Nuisance("axial", index, vibration.axial_uncertainty_m),
            Nuisance("gain", index, vibration.gain_uncertainty),
            Nuisance("phase", index, vibration.phase_uncertainty_rad),
            Nuisance("area", index, vibration.area_uncertainty),
        ]
    return tuple(nuisance for nuisance in nuisances if nuisance.uncertainty > 0)


def _values(deviations: dict[tuple[str, int], float], kind: str, vibrations: tuple[int, ...]) -> FloatArray:
    """Return the nuisances of one ``kind`` (vibration,), zero where a vibration has none."""
    return np.array([deviations.get((kind, vibration), 0.0) for vibration in vibrations])


def _data_covariance_m2(vibration: Vibration, push: Push) -> FloatArray:
    """Return the covariance of a vibration's phasors, real and imaginary parts: noise, and error of the force's shape.

    The error of the shape is proportional to the amplitude and counts as independent between frequencies.
    """
    model_error_m = push.shape_relative * np.repeat(np.abs(vibration.phasor_m), 2)
    return np.asarray(vibration.covariance_m2 + np.diag(model_error_m**2))


def _first_at_position(vibrations: Sequence[Vibration]) -> tuple[int, ...]:
    """Return for every vibration the index of the first one at its position; its own if it names none."""
    first: dict[str, int] = {}
    return tuple(
        first.setdefault(vibration.position, i) if vibration.position else i for i, vibration in enumerate(vibrations)
    )
