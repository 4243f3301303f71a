"""Complex values of a result with the covariance of their errors, source by source.

    y = A exp(j phase),    error of y = sum_k c_k x_k

x_k are independent variables of mean 0 and variance 1. c_k, complex, is the influence of x_k on y: its real part on the
in-phase value A cos(phase), its imaginary part on the quadrature A sin(phase). Values with a common error have
influences of the same variable. Influences of all sources on all values form B; the covariance is B B'.

Source: Guide to the expression of uncertainty in measurement (GUM), supplement 2 (JCGM 102:2011), 6.2.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hpe_rig.arrays import ComplexArray, FloatArray, Int64Array
from hpe_rig.result.influence import MAX_INFLUENCE_BYTES, Influence, Scope
from hpe_rig.result.interval import coverage_factor, effective_degrees_of_freedom
from hpe_rig.result.values import ShotResult

PARTS: Final = ("in-phase", "quadrature")
"""Parts of a complex value A exp(j phase): A cos(phase) and A sin(phase)."""
NO_VARIABLE: Final = -1
"""Variable number of a column without influence on a shot."""
NEGLIGIBLE_VARIANCE = 1e-8
"""Part of each variance that may be lost when the influences of many variables are stored as those of few."""


@dataclass(frozen=True, slots=True)
class Combination:
    """Standard uncertainties of a linear combination of complex values, in the unit of the combination.

    Each array (2,): of real and imaginary part. ``covariance`` (2, 2). ``interval_95``: half widths of the 95 %
    intervals, from ``degrees_of_freedom``.
    """

    uncertainty: FloatArray
    covariance: FloatArray
    degrees_of_freedom: FloatArray
    interval_95: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Covariance:
    """Complex values of all shots and frequencies with the errors that they have in common.

    ``shot`` (row,): number of the shot, from 1; a shot has one row for each processing window. ``frequency_hz`` and
    ``phasor_m``, complex (row, frequency): headline values A exp(j phase), NaN if absent. ``influence_m``, complex
    (row, frequency, column): error of a value per standard deviation of the column's variable. ``variable``
    (row, column): number of that variable; equal numbers are the same variable. ``source`` and ``common_to`` (column,):
    source of uncertainty, and the shots with the same variable ("shot", "setting", "position" or "run").
    ``degrees_of_freedom`` (row, column).
    """

    shot: Int64Array
    frequency_hz: FloatArray
    phasor_m: ComplexArray
    influence_m: ComplexArray
    variable: Int64Array
    source: tuple[str, ...]
    common_to: tuple[str, ...]
    degrees_of_freedom: FloatArray

    @property
    def sources(self) -> tuple[str, ...]:
        """Names of the sources of uncertainty."""
        return tuple(dict.fromkeys(self.source))

    def influences_m(self, sources: Iterable[str] | None = None) -> ComplexArray:
        """Return the influence (row, frequency, variable) of every variable on every value, complex.

        ``sources``: only these sources of uncertainty; by default all.
        """
        columns = self._columns(sources)
        numbers, index = np.unique(self.variable[:, columns], return_inverse=True)
        rows, frequencies = self.phasor_m.shape
        influences_m = np.zeros((rows, frequencies, numbers.size), np.complex128)
        for row, of_row in enumerate(np.reshape(index, (rows, -1))):
            # Several columns can have the same variable: their influences add.
            np.add.at(influences_m[row].T, of_row, self.influence_m[row][:, columns].T)
        return influences_m

    def matrix_m2(self, sources: Iterable[str] | None = None) -> FloatArray:
        """Return the covariance (row, frequency, part, row, frequency, part) of in-phase and quadrature values, m².

        ``part`` 0 is in-phase, 1 quadrature. ``sources``: only these sources of uncertainty; by default all.
        """
        influences_m = self.influences_m(sources)
        components_m = np.stack([influences_m.real, influences_m.imag], axis=2)
        flat_m = components_m.reshape(-1, components_m.shape[-1])
        return np.asarray(flat_m @ flat_m.T).reshape(2 * components_m.shape[:3])

    def combined(self, weights: ComplexArray, sources: Iterable[str] | None = None) -> Combination:
        """Return the uncertainty of the sum of ``weights`` (row, frequency) times values.

        Weights are derivatives of a function of the values: 1 and -1 for a difference; -1 / y_1 and 1 / y_2 for
        ln(y_2 / y_1). Its real part is the relative amplitude ratio, its imaginary part the phase difference, rad.
        ``sources``: only these sources of uncertainty; by default all.
        """
        columns, weights = self._columns(sources), np.asarray(weights, np.complex128)
        if weights.shape != self.phasor_m.shape:
            raise ValueError(
                f"weights have the shape {weights.shape}, values {self.phasor_m.shape}. "
                "Try: one weight for each shot and frequency, 0 for values that do not enter"
            )
        # Error of the sum by column, then by variable: equal variables add up.
        by_column = np.einsum("rf,rfc->rc", np.nan_to_num(weights), self.influence_m[:, :, columns])
        numbers, index = np.unique(self.variable[:, columns], return_inverse=True)
        by_variable = np.zeros((2, numbers.size))
        for component, errors in zip(by_variable, (by_column.real, by_column.imag), strict=True):
            np.add.at(component, index.ravel(), errors.ravel())
        covariance = by_variable @ by_variable.T
        uncertainty = np.sqrt(np.diag(covariance))
        freedom = self.degrees_of_freedom[:, columns]
        degrees = np.array(
            [
                _effective_degrees(errors, freedom, u)
                for errors, u in zip((by_column.real, by_column.imag), uncertainty.tolist(), strict=True)
            ]
        )
        factors = np.array([coverage_factor(value) for value in degrees])
        return Combination(uncertainty, covariance, degrees, factors * uncertainty)

    def _columns(self, sources: Iterable[str] | None) -> list[int]:
        """Return the columns of ``sources``, all if None; raise ``ValueError`` for an unknown source."""
        selected = set(self.source if sources is None else sources)
        if unknown := sorted(selected - set(self.source)):
            raise ValueError(
                f"no source of uncertainty is called {', '.join(unknown)}. Try: one of {', '.join(self.sources)}"
            )
        return [column for column, source in enumerate(self.source) if source in selected]


def _effective_degrees(errors: FloatArray, degrees_of_freedom: FloatArray, uncertainty: float) -> float:
    """Return the degrees of freedom of a sum with ``errors`` (row, column) and their ``degrees_of_freedom``.

    Variables with the same finite degrees of freedom in one row follow from the same residual (Welch-Satterthwaite).
    """
    finite = [
        (float(np.linalg.norm(row[degrees == value])), float(value))
        for row, degrees in zip(errors, degrees_of_freedom, strict=True)
        for value in np.unique(degrees[np.isfinite(degrees)])
    ]
    remaining = max(uncertainty**2 - sum(u**2 for u, _ in finite), 0.0)
    return effective_degrees_of_freedom([*finite, (math.sqrt(remaining), math.inf)])


def covariance_grid(covariance: Covariance) -> dict[str, tuple[tuple[str, ...], NDArray[Any], str]]:
    """Return dimensions, values and unit of every array of ``covariance``, as real numbers and text.

    Dimension ``part`` is that of ``PARTS``. Text has the unit "".
    """
    return {
        "phasor_m": (("shot", "frequency", "part"), _real_and_imaginary(covariance.phasor_m), "m"),
        "influence_m": (("shot", "frequency", "column", "part"), _real_and_imaginary(covariance.influence_m), "m"),
        "variable": (("shot", "column"), covariance.variable, "1"),
        "degrees_of_freedom": (("shot", "column"), covariance.degrees_of_freedom, "1"),
        "source": (("column",), np.array(covariance.source, np.str_), ""),
        "common_to": (("column",), np.array(covariance.common_to, np.str_), ""),
    }


def _real_and_imaginary(values: ComplexArray) -> FloatArray:
    """Return real and imaginary parts along a new last axis."""
    return np.stack([values.real, values.imag], axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class _Block:
    """Influences of one source on one row; blocks with equal ``group`` have the same variables."""

    row: int
    group: Hashable
    error: Influence


def _filled(
    slots: Sequence[Sequence[_Block]], sizes: Sequence[int], rows: int, frequencies: int
) -> tuple[ComplexArray, Int64Array, FloatArray]:
    """Return influences (row, frequency, column), numbers of variables and degrees of freedom (row, column).

    Each slot has as many columns as ``sizes`` states. Blocks of one group share their variables.
    """
    influence_m = np.zeros((rows, frequencies, sum(sizes)), np.complex128)
    variable = np.full((rows, sum(sizes)), NO_VARIABLE, np.int64)
    degrees_of_freedom = np.full((rows, sum(sizes)), np.inf)
    starts = (np.cumsum(sizes) - sizes).tolist()
    first_numbers: dict[Hashable, int] = {}
    next_number = 0
    for start, block in ((start, block) for start, slot in zip(starts, slots, strict=True) for block in slot):
        block_frequencies, size = block.error.influence_m.shape
        if block.group not in first_numbers:
            first_numbers[block.group] = next_number
            next_number += size
        columns = slice(start, start + size)
        influence_m[block.row, :block_frequencies, columns] = block.error.influence_m
        variable[block.row, columns] = first_numbers[block.group] + np.arange(size)
        degrees_of_freedom[block.row, columns] = block.error.degrees_of_freedom
    return influence_m, variable, degrees_of_freedom


def covariance_of(results: Sequence[Sequence[ShotResult]]) -> Covariance:
    """Return phasors and covariance of all shots of ``results``, each the shots of one run.

    Errors common to a run count as common to all ``results``; all others differ between runs. Raises ``ValueError`` for
    a shot without influences.
    """
    rows = [(run, shot) for run, shots in enumerate(results) for shot in shots]
    slots: dict[tuple[str, str, str], list[_Block]] = {}
    for block in _with_few_variables(_blocks(rows)):
        slots.setdefault((block.error.source, block.error.common_to, block.error.variables), []).append(block)
    sizes = [max(block.error.influence_m.shape[1] for block in slot) for slot in slots.values()]
    count = max((len(shot.estimates) for _, shot in rows), default=0)
    influence_m, variable, degrees_of_freedom = _filled(list(slots.values()), sizes, len(rows), count)
    estimates, used = [[*shot.estimates] for _, shot in rows], influence_m.any(axis=(0, 1))
    return Covariance(
        shot=np.array([shot.shot for _, shot in rows], dtype=np.int64),
        frequency_hz=_padded([[item.frequency_hz for item in row] for row in estimates], count).real,
        phasor_m=_padded([[item.phasor_m for item in row] for row in estimates], count),
        influence_m=influence_m[:, :, used],
        variable=variable[:, used],
        source=tuple(np.repeat([source for source, _, _ in slots], sizes)[used].tolist()),
        common_to=tuple(np.repeat([common_to for _, common_to, _ in slots], sizes)[used].tolist()),
        degrees_of_freedom=degrees_of_freedom[:, used],
    )


def _blocks(rows: Sequence[tuple[int, ShotResult]]) -> list[_Block]:
    """Return the influences of ``rows``, each a number of a run and a shot; raise ``ValueError`` if a shot has none."""
    if not all(shot.influences for _, shot in rows):
        raise ValueError(
            f"the result holds no covariance: influences of its {len(rows)} shots exceed "
            f"{MAX_INFLUENCE_BYTES / 1e6:g} MB. Try: fewer shots, as in a run of each setting"
        )
    return [
        _Block(row, _group(run, shot, error), error)
        for row, (run, shot) in enumerate(rows)
        for error in shot.influences
    ]


def _group(run: int, shot: ShotResult, error: Influence) -> Hashable:
    """Return a key that is equal for influences with the same variables."""
    position = run, shot.lateral_offset_m, shot.axial_offset_m
    settings = shot.burst_length_s, shot.force_fraction, shot.pulse_rate_hz, shot.window_length_s
    keys: dict[Scope, Hashable] = {
        "shot": (run, shot.index, shot.window_length_s),
        "setting": (position, settings, *shot.swept.values()),
        "position": position,
        "run": (),
    }
    # Ensembles of different size have different members.
    return error.variables, error.influence_m.shape[1], error.common_to, keys[error.common_to]


def _with_few_variables(blocks: Sequence[_Block]) -> Iterator[_Block]:
    """Yield ``blocks`` with the influences of many variables replaced by those of few with the same covariance."""
    groups: dict[Hashable, list[_Block]] = {}
    for block in blocks:
        groups.setdefault(block.group, []).append(block)
    for group in groups.values():
        frequencies, variables = group[0].error.influence_m.shape
        if variables <= 2 * frequencies:
            yield from group
            continue
        # Any orthogonal matrix changes the variables but no covariance. Rows of unit length: weak harmonics count as
        # much as strong ones.
        stacked = np.vstack([block.error.influence_m for block in group])
        rows = np.vstack([stacked.real, stacked.imag])
        rows /= np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), np.finfo(np.float64).tiny)
        variances, directions = np.linalg.eigh(rows.T @ rows)
        reduced = stacked @ directions[:, np.cumsum(variances) > NEGLIGIBLE_VARIANCE]
        ends = np.cumsum([len(block.error.influence_m) for block in group])
        for block, influence_m in zip(group, np.split(reduced, ends[:-1]), strict=True):
            yield replace(block, error=replace(block.error, influence_m=influence_m))


def _padded(rows: Sequence[Sequence[complex]], count: int) -> ComplexArray:
    """Return ``rows`` as an array with ``count`` columns, NaN where a row has fewer values."""
    padded = np.full((len(rows), count), math.nan, np.complex128)
    for row, values in enumerate(rows):
        padded[row, : len(values)] = values
    return padded
