"""Power series of the echoes in the amplitudes of the motion: the cost hardly grows with the number of echoes.

The motion is a sum of a few spatial shapes, each with an amplitude, so the series has several variables.

Scatterer n of echo k has the delay tau_kn = tau_n + sum_r b_kr g_rn. Each exponential of the pulse is expanded in it:

    exp(-j w sum_r b_kr g_rn) = sum_a (-j w)^|a| (b_k^a / a!) g_n^a
    r_k(t) = sum_a (b_k^a / a!) U_a(t) + crossings
    U_a(t) = Re sum_m c_m (-j w_m)^|a| exp(j w_m t) sum_(n alive at t) I_n g_n^a exp(-j w_m tau_n)

    k, n, r, m    echo, scatterer, shape of the motion, exponential of the pulse
    tau_n, I_n    delay at rest, s; weight
    b_kr, g_rn    amplitude of the motion as a delay, s; shape of the motion, 1
    c_m, w_m      amplitude and angular frequency of an exponential, 1 and rad/s
    a             multi-index of a term: one power a_r for each shape; |a| their sum, a! the product of their factorials
    alive         t lies in the pulse's support [tau_n + start, tau_n + end)

The series moves the exponentials but not the edges (start and end) of the support. A sample that an edge crosses while
its scatterer moves is corrected with the pulse's Taylor series about that edge. Both parts converge geometrically for
any pulse.
Derivation, cost and error: docs/explanation/echoes.md, section 3.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from sim_backend.arrays import ComplexArray, FloatArray, Int64Array
from sim_backend.echoes.exact_sums import is_alive_in_block, running_sum_cell, running_sums
from sim_backend.echoes.pulse import Pulse, phasors

MAX_ANGLE_RAD = 3.0
"""Largest phase change of the highest frequency; beyond it the terms grow and cancel, which costs digits."""
MAX_TERMS = 1000
"""Most terms of a series: more would need sums of over 10 MB for a gate."""

_VALUES_PER_CHUNK = 1 << 15  # complex values of one temporary array, 0.5 MB, which fits the cache
_MIN_SCATTERERS_PER_CHUNK = 256
_MAX_POWER = 64
_ENVELOPE_ORDERS = 8  # derivatives that bound the pulse near an edge of its support, to 1 %
_TAYLOR_ORDERS = 40
# Fractions of the tolerance: for the terms left out of the series, and for the corrections left out.
_TAIL_FRACTION = 0.25
_CROSSING_FRACTION = 0.1
# A derivative below this fraction of the sum of its parts is exactly 0 on paper, such as the Hann pulse at its edges.
_CANCELLATION = 1e-12


MultiIndex = tuple[int, ...]
"""Multi-index a of a term: the power a_r of each shape's amplitude."""


@dataclass(frozen=True, slots=True)
class ScattererRows:
    """Moving scatterers of one or more draws or gates ("rows"), in ascending row and, within it, delay."""

    row: Int64Array
    """(scatterer,), the row that the scatterer belongs to."""
    rest_s: FloatArray
    """(scatterer,), echo delay at rest, tau_n."""
    weight: FloatArray
    """(scatterer,), I_n."""
    shape: FloatArray
    """(shape, scatterer), g_rn."""
    amplitude_s: FloatArray
    """(row, echo, shape), b_kr: the delay that a shape of 1 adds."""
    response: ComplexArray | None = None
    """(frequency, scatterer), relative response of the beam at each frequency of the pulse; None: 1."""

    @property
    def row_bounds(self) -> list[int]:
        """First scatterer of each row, and the number of scatterers at the end."""
        bounds: list[int] = self.row.searchsorted(np.arange(len(self.amplitude_s) + 1)).tolist()
        return bounds


def shape_angles_rad(pulse: Pulse, shape: FloatArray, amplitude_s: FloatArray) -> tuple[float, ...]:
    """Return, for each spatial shape of the motion, the largest phase change that it can cause, rad (shape,).

    The phase is that of the pulse's highest frequency. ``shape`` (shape, scatterer), ``amplitude_s`` (..., echo,
    shape): the delay of a scatterer changes by amplitude times shape. The bound is the product of the largest
    magnitudes of both and the angular frequency.
    """
    if shape.size == 0 or amplitude_s.size == 0:
        return (0.0,) * len(shape)
    highest_rad_per_s = 2 * math.pi * max(abs(hz) for hz in pulse.frequency_hz)
    max_amplitude_s = np.abs(amplitude_s).max(axis=tuple(range(amplitude_s.ndim - 1)))
    max_shape = np.abs(shape).max(axis=1)
    return tuple((highest_rad_per_s * (max_amplitude_s * max_shape)).tolist())


@functools.lru_cache(maxsize=32)
def series_terms(angles_rad: tuple[float, ...], tolerance: float) -> tuple[MultiIndex, ...] | None:
    """Return the terms of the power series that matter to ``tolerance``, each as the powers of the shapes' amplitudes.

    ``angles_rad`` (shape,): largest phase change by each shape of the motion. A term with the powers a_r adds at most
    prod_r angle_r^a_r / a_r!; terms with a bound below a fraction of the tolerance are left out. Terms are in the order
    of their degrees, the sums of powers. None for a motion of more than ``MAX_ANGLE_RAD`` or a series of more than
    ``MAX_TERMS`` terms.
    """
    if sum(angles_rad) > MAX_ANGLE_RAD:
        return None
    limit = min(0.5, _TAIL_FRACTION * tolerance)
    # Powers of the shapes so far, and the bound on the size of such a term. Each further shape adds a power.
    terms: list[tuple[MultiIndex, float]] = [((), 1.0)]
    for angle in angles_rad:
        bounds = _power_bounds(angle, limit)
        terms = [
            ((*powers, power), bound * factor)
            for powers, bound in terms
            for power, factor in enumerate(bounds)
            if bound * factor > limit
        ]
        if len(terms) > MAX_TERMS:
            return None
    return tuple(sorted((powers for powers, _ in terms), key=lambda powers: (sum(powers), powers)))


def _power_bounds(angle_rad: float, limit: float) -> list[float]:
    """Return a bound on the size of the term of each power p = 0, 1, ... of exp(angle), until it falls to ``limit``.

    For an angle above 1 the terms angle^p / p! rise before they fall. The bound is the largest term from p on, so that
    a term with a lower power than a selected one is selected too.
    """
    terms = [1.0]
    while len(terms) < _MAX_POWER and (terms[-1] > limit or len(terms) <= angle_rad):
        terms.append(terms[-1] * angle_rad / len(terms))
    return list(itertools.accumulate(reversed(terms), max))[::-1]


def series(
    scatterer_rows: ScattererRows, pulse: Pulse, sample_time_s: FloatArray, tolerance: float, out: FloatArray
) -> None:
    """Write the echoes to ``out``, float64 (row, echo, sample), by a power series in the amplitudes of the motion.

    A scatterer's delay is that at rest plus the sum of amplitudes times shapes. The series has one variable for each
    shape, its amplitude; a term is a product of powers of them. The rms error is ``tolerance`` of the echoes' rms.
    ``sample_time_s`` (sample,) is at most as long as the pulse. Raises ValueError for too large a motion or too many
    terms.
    """
    angles_rad = shape_angles_rad(pulse, scatterer_rows.shape, scatterer_rows.amplitude_s)
    terms = series_terms(angles_rad, tolerance)
    if terms is None:
        raise ValueError(
            f"the motion changes the pulse's phase by {sum(angles_rad):.3g} rad in {len(angles_rad)} shapes, the "
            f"series holds up to {MAX_ANGLE_RAD} rad and {MAX_TERMS} terms: take the running sum"
        )
    steps = _power_steps(terms)
    # The degree of a term is the sum of its powers; the last term has the highest.
    degrees = [sum(powers) for powers in terms]
    tables = _tables(pulse, sample_time_s.tobytes(), degrees[-1] + 1)
    # For each scatterer at rest, the first samples at or after the start and the end of its pulse.
    enter = sample_time_s.searchsorted(scatterer_rows.rest_s + pulse.start_s)
    leave = sample_time_s.searchsorted(scatterer_rows.rest_s + pulse.end_s)
    # An echo is the sum over terms of U_a(t), a sum over the scatterers at rest, times its amplitude factor b^a / a!.
    sums = _sums_at_rest(scatterer_rows, enter, leave, steps, np.array(degrees), tables, pulse)
    np.matmul(_amplitude_factors(scatterer_rows.amplitude_s * tables.scale_rad_per_s, steps), sums, out=out)
    # The series moves the pulses but not their edges: correct the samples that a moving edge crosses. All corrections
    # left out may add up to a fraction of the tolerance, relative to the norm of the echo at rest (term 0) in the gate.
    rms_at_rest = math.sqrt(float(np.vdot(sums[:, 0], sums[:, 0])) / sums[:, 0].size)
    max_omitted = _CROSSING_FRACTION * tolerance * rms_at_rest * math.sqrt(len(sample_time_s))
    _correct_crossings(out, scatterer_rows, tables, pulse, sample_time_s, max_omitted)


class _PowerStep(NamedTuple):
    """Step from one term of the series to another, with a power larger by 1 for one shape.

    The factor b^a / a! of the second term is that of the first times b_r / a_r.
    """

    lower_term: int
    """Index of the first term, with the smaller power."""
    shape: int
    """Index r of the shape with the larger power."""
    power: int
    """Power a_r after the step, the divisor of the factor."""


def _power_steps(terms: tuple[MultiIndex, ...]) -> list[_PowerStep]:
    """Return, for each term of the series but the first, the lower term and the component that multiplies it.

    A term is a product of powers of the motion's components, one for each spatial shape. In the lower term, the power
    of one component is smaller by 1.
    """
    index = {powers: position for position, powers in enumerate(terms)}
    steps = []
    for powers in terms[1:]:
        component = next(number for number, power in enumerate(powers) if power)
        lower = (*powers[:component], powers[component] - 1, *powers[component + 1 :])
        steps.append(_PowerStep(lower_term=index[lower], shape=component, power=powers[component]))
    return steps


@dataclass(frozen=True, slots=True)
class _Tables:
    """Values that depend on the pulse and the sample times alone."""

    scale_rad_per_s: float
    """Highest angular frequency of the pulse; amplitudes b are multiplied by it, frequencies divided."""
    delay_derivatives: ComplexArray
    """(frequency, degree, sample): c_m (-j w_m / scale)^degree exp(j w_m t), derivatives by the delay."""
    envelope_taylor: ComplexArray
    """(edge, frequency, order): Taylor coefficients of the complex envelope about start and end of the support."""
    pulse_taylor: ComplexArray
    """(edge, frequency, order): Taylor coefficients of the pulse about start and end, sign reversed at the end."""


@functools.lru_cache(maxsize=32)
def _tables(pulse: Pulse, sample_times: bytes, degrees: int) -> _Tables:
    """Return the factors of the series that depend on pulse and sample times only, for derivatives below ``degrees``.

    ``sample_times``: the bytes of an array, which can be a cache key. Cached, since records and studies share few
    gates.
    """
    hz, amplitude = np.array(pulse.frequency_hz), np.array(pulse.amplitude)
    # A derivative of c exp(j w (t - tau)) by the delay tau multiplies c by -j w; here w is over the highest w.
    factor = amplitude[:, None] * np.power((-1j * hz / np.abs(hz).max())[:, None], np.arange(degrees))
    exponentials = phasors(pulse, np.frombuffer(sample_times), 1)
    # The envelope, for a bound on the pulse near an edge, is the pulse shifted down by its strongest frequency.
    carrier_hz = pulse.frequency_hz[int(np.argmax(np.abs(amplitude)))]
    edges_s = (pulse.start_s, pulse.end_s)
    envelope_taylor = np.stack([_edge_taylor(pulse, edge_s, carrier_hz, _ENVELOPE_ORDERS) for edge_s in edges_s])
    pulse_taylor = np.stack([_edge_taylor(pulse, edge_s, 0.0, _TAYLOR_ORDERS) for edge_s in edges_s])
    pulse_taylor[1] *= -1
    return _Tables(
        scale_rad_per_s=float(2 * math.pi * np.abs(hz).max()),
        delay_derivatives=factor[:, :, None] * exponentials[:, None],
        envelope_taylor=envelope_taylor,
        pulse_taylor=pulse_taylor,
    )


def _edge_taylor(pulse: Pulse, edge_s: float, shift_hz: float, orders: int) -> ComplexArray:
    """Return the Taylor coefficients of each exponential of the pulse about its start or end, (frequency, order).

    ``edge_s``: time of the start or end. ``shift_hz``: subtracted from all frequencies, so that the strongest one
    gives the coefficients of the pulse's complex envelope (up to a phase), and 0 those of the pulse.
    """
    omega = 2 * np.pi * np.array(pulse.frequency_hz)
    rate = 1j * (omega - 2 * np.pi * shift_hz)
    coefficients = np.empty((len(omega), orders), dtype=np.complex128)
    coefficients[:, 0] = np.array(pulse.amplitude) * np.exp(1j * omega * edge_s)
    for order in range(1, orders):
        coefficients[:, order] = coefficients[:, order - 1] * rate / order
    return coefficients


def _amplitude_factors(amplitude_rad: FloatArray, steps: list[_PowerStep]) -> FloatArray:
    """Return the factors b_k^a / a! of the power series in the motion's amplitudes, (row, echo, term).

    A term has a multi-index a, a power a_r for each shape r of the motion: b_k^a / a! is the product over r of
    b_kr^a_r / a_r!. ``amplitude_rad`` (row, echo, shape): b_kr times the pulse's highest angular frequency. A row is a
    draw of scatterers or a gate.
    """
    ones = np.ones(amplitude_rad.shape[:2])
    factors = _term_values(ones, steps, (amplitude_rad[..., step.shape] / step.power for step in steps))
    return np.ascontiguousarray(np.moveaxis(factors, 0, -1))


def _term_values(first_term: FloatArray, steps: list[_PowerStep], factors: Iterable[FloatArray]) -> FloatArray:
    """Return the values of all terms of the series, (term, *first_term); the first one has all powers 0.

    Each of ``steps`` leads from a lower term to the next one, by multiplication with its entry of ``factors``.
    """
    values = np.empty((len(steps) + 1, *first_term.shape))
    values[0] = first_term
    for term, (step, factor) in enumerate(zip(steps, factors, strict=True), 1):
        np.multiply(values[step.lower_term], factor, out=values[term])
    return values


def _sums_at_rest(
    scatterer_rows: ScattererRows,
    enter: Int64Array,
    leave: Int64Array,
    steps: list[_PowerStep],
    degree: Int64Array,
    tables: _Tables,
    pulse: Pulse,
) -> FloatArray:
    """Return the sums over the scatterers at rest for every term a of the series, U_a(t), float64 (row, term, sample).

    Scatterers that enter or leave at the same sample are first summed in a cell. Running sums of cells over the samples
    are then sums over the scatterers whose pulse is alive (lasts) at each sample.

    ``enter`` and ``leave`` (scatterer,): first samples at or after start and end of each scatterer's pulse, which may
    be alive in the block of samples or not. ``degree`` (term,): sum of the term's powers.
    """
    frequencies, _, samples = tables.delay_derivatives.shape
    derivatives = tables.delay_derivatives[:, degree]
    sums = np.empty((len(scatterer_rows.amplitude_s), len(degree), samples))
    row_bounds = scatterer_rows.row_bounds
    # Some rows at a time, so that their cells stay in the cache: two for each sample, for entering and leaving.
    rows_per_chunk = max(1, _VALUES_PER_CHUNK // (frequencies * len(degree) * 2 * samples))
    for first_row in range(0, len(sums), rows_per_chunk):
        rows = slice(first_row, min(first_row + rows_per_chunk, len(sums)))
        first, end = row_bounds[rows.start], row_bounds[rows.stop]
        alive = first + np.flatnonzero(is_alive_in_block(enter[first:end], leave[first:end], samples))
        # Sums over the scatterers alive at each sample, (frequency, term, row, sample).
        cell = running_sum_cell(scatterer_rows.row[alive] - rows.start, enter[alive], leave[alive], samples)
        cells = np.zeros((frequencies, len(degree), rows.stop - rows.start, 2, samples), dtype=np.complex128)
        _add_to_cells(cells.reshape(frequencies, len(degree), -1), scatterer_rows, alive, cell, steps, pulse)
        alive_sums = running_sums(cells)
        # U_a = Re sum_m c_m (-j w_m)^|a| exp(j w_m t) alive_sums. f: frequency m, a: term, r: row, t: sample.
        sums[rows] = np.einsum("fat,fart->rat", derivatives, alive_sums).real
    return sums


def _add_to_cells(
    cells: ComplexArray,
    scatterer_rows: ScattererRows,
    scatterers: Int64Array,
    cell: Int64Array,
    steps: list[_PowerStep],
    pulse: Pulse,
) -> None:
    """Add the summand of each scatterer, at every frequency and for every term of the series, to ``cells``, in place.

    ``cells`` (frequency m, term a, cell): sums over the scatterers that enter or leave at the same sample. The summand
    of scatterer n is I_n g_n^a exp(-j w_m tau_n), with I_n its weight, g_n the shapes of the motion at it (g_n^a the
    product of their powers) and tau_n its delay at rest. ``scatterers`` (scatterer,): their indices. ``cell``
    (scatterer,): index of the cell of each; equal ones are neighbours.
    """
    frequencies, terms, _ = cells.shape
    chunk_length = max(_MIN_SCATTERERS_PER_CHUNK, _VALUES_PER_CHUNK // (frequencies * terms))
    for first in range(0, len(scatterers), chunk_length):
        chunk = scatterers[first : first + chunk_length]
        # Where a run of scatterers with the same cell starts, and that cell: each run is summed, then added at once.
        starts = np.flatnonzero(np.diff(cell[first : first + chunk_length], prepend=-1))
        cell_of_run = cell[first + starts]
        # exp(-j w_m tau_n) times the beam's response, (frequency, scatterer).
        phasor = phasors(pulse, scatterer_rows.rest_s[chunk], -1)
        if scatterer_rows.response is not None:
            phasor *= scatterer_rows.response[:, chunk]
        # I_n g_n^a, (term, scatterer): each term is a lower one times a shape.
        shape = scatterer_rows.shape[:, chunk]
        weight_moments = _term_values(scatterer_rows.weight[chunk], steps, [shape[step.shape] for step in steps])
        # Some terms at a time: their products with all phasors fit the cache.
        terms_per_group = max(1, _VALUES_PER_CHUNK // (frequencies * len(chunk)))
        for first_term in range(0, terms, terms_per_group):
            group = slice(first_term, first_term + terms_per_group)
            products = phasor[:, None] * weight_moments[group]
            cells[:, group, cell_of_run] += np.add.reduceat(products, starts, axis=-1)


@dataclass(frozen=True, slots=True)
class _Crossings:
    """Edges (starts and ends) of scatterers' pulses that may pass a sample as their scatterer moves.

    Every array (edge,).
    """

    scatterer: Int64Array
    """Index of the scatterer."""
    edge: Int64Array
    """0 for the start of the pulse, 1 for its end."""
    time_s: FloatArray
    """Time of the edge for the scatterer at rest."""
    first_sample: Int64Array
    """First sample that the edge can reach."""
    sample_count: Int64Array
    """Number of consecutive samples that the edge can reach."""

    def selected(self, indices: slice | Int64Array) -> _Crossings:
        """Return the edges with these ``indices``."""
        return _Crossings(*(getattr(self, field.name)[indices] for field in fields(self)))


def _correct_crossings(
    out: FloatArray,
    scatterer_rows: ScattererRows,
    tables: _Tables,
    pulse: Pulse,
    sample_time_s: FloatArray,
    max_omitted: float,
) -> None:
    """Correct ``out`` (row, echo, sample), in place, at samples that the start or end of a moving pulse crosses.

    The power series describes a moving pulse between the edges (start and end) that it has at rest. A sample between an
    edge at rest and the moved edge is therefore wrong. ``max_omitted``: size of the corrections that may be left out in
    total.
    """
    # Largest change of each scatterer's delay by the motion.
    reach_s = np.abs(scatterer_rows.amplitude_s).max(axis=(0, 1)) @ np.abs(scatterer_rows.shape)
    max_reach_s, max_weight = float(reach_s.max(initial=0.0)), float(np.abs(scatterer_rows.weight).max(initial=0.0))
    if max_reach_s == 0 or max_weight == 0:
        return
    # Divide the total equally among the samples that the two edges of each scatterer can cross.
    duration_s = float(sample_time_s[-1] - sample_time_s[0])
    samples_per_edge = 1 + (2 * max_reach_s * (len(sample_time_s) - 1) / duration_s if duration_s > 0 else 0)
    max_error = max_omitted / (2 * len(reach_s) * samples_per_edge)
    crossings = _significant_edges(scatterer_rows, tables, pulse, sample_time_s, reach_s, max_error)
    # As many Taylor terms as the same error needs for the heaviest scatterer and the farthest shift of an edge.
    pulse_bound = max(1.0, float(np.abs(pulse.amplitude).sum()))
    term_count = _taylor_term_count(tables.scale_rad_per_s * max_reach_s, max_error / max_weight / pulse_bound)
    taylor = tables.pulse_taylor[:, :, :term_count]
    edges_per_chunk = max(1, _VALUES_PER_CHUNK // (out.shape[1] * int(crossings.sample_count.max(initial=1))))
    for first in range(0, len(crossings.edge), edges_per_chunk):
        chunk = crossings.selected(slice(first, first + edges_per_chunk))
        _correct_edges(out, scatterer_rows, chunk, taylor, sample_time_s)


def _significant_edges(
    scatterer_rows: ScattererRows,
    tables: _Tables,
    pulse: Pulse,
    sample_time_s: FloatArray,
    reach_s: FloatArray,
    max_error: float,
) -> _Crossings:
    """Return the edges (starts and ends) of pulses that can pass a sample and change it by more than ``max_error``.

    An edge moves with its scatterer by up to ``reach_s`` (scatterer,), the largest change of the scatterer's delay. As
    it passes a sample, it adds to the sample, or removes from it, the pulse's value near the edge.
    """
    # Scatterers with more than the error near the start of their pulse, then near its end: weight times pulse.
    starting, ending = (
        np.flatnonzero(
            np.abs(scatterer_rows.weight) * _pulse_bound_near_edge(scatterer_rows.response, taylor, reach_s) > max_error
        )
        for taylor in tables.envelope_taylor
    )
    scatterer = np.concatenate([starting, ending])
    edge = np.repeat([0, 1], [len(starting), len(ending)])
    # Time of the start or end at rest, and the samples that it can reach.
    time_s = scatterer_rows.rest_s[scatterer] + np.array([pulse.start_s, pulse.end_s])[edge]
    first_sample = sample_time_s.searchsorted(time_s - reach_s[scatterer])
    sample_count = sample_time_s.searchsorted(time_s + reach_s[scatterer], side="right") - first_sample
    return _Crossings(scatterer, edge, time_s, first_sample, sample_count).selected(np.flatnonzero(sample_count))


def _pulse_bound_near_edge(response: ComplexArray | None, taylor: ComplexArray, reach_s: FloatArray) -> FloatArray:
    """Return a bound (scatterer,) on the magnitude of each scatterer's pulse near one of its edges (start or end).

    Near means within ``reach_s`` (scatterer,), the largest shift of the edge by motion. The bound is
    sum_q |e_q| reach^q, with the Taylor coefficients e_q of the pulse's envelope about the edge. ``taylor`` (frequency,
    order): those of each frequency component. ``response`` (frequency, scatterer): factor of each one, None for 1.
    """
    # Coefficients of the envelope, (order, scatterer or 1). Sums that cancel to rounding error count as zero.
    coefficient = taylor.sum(axis=0)[:, None] if response is None else np.einsum("fs,fq->qs", response, taylor)
    magnitude, summed_magnitudes = np.abs(coefficient), np.abs(taylor).sum(axis=0)
    # Horner's rule over the orders.
    bound = np.zeros(len(reach_s))
    for order in range(len(magnitude) - 1, -1, -1):
        cancels = magnitude[order] < _CANCELLATION * summed_magnitudes[order]
        bound = bound * reach_s + np.where(cancels, 0.0, magnitude[order])
    return bound


def _correct_edges(
    out: FloatArray,
    scatterer_rows: ScattererRows,
    crossings: _Crossings,
    taylor: ComplexArray,
    sample_time_s: FloatArray,
) -> None:
    """Correct ``out`` (row, echo, sample), in place, at all samples that the edges in ``crossings`` can reach.

    An edge is the start or the end of a scatterer's pulse, which moves with the scatterer. ``taylor`` (edge, frequency,
    order): Taylor coefficients of each exponential of the pulse about start and end.
    """
    # A pair is an edge and one of the samples within its reach: index of its edge, and its sample, (pair,).
    count = crossings.sample_count
    pair = np.repeat(np.arange(len(count)), count)
    index_in_edge = np.arange(len(pair)) - np.repeat(np.cumsum(count) - count, count)
    sample = np.repeat(crossings.first_sample, count) + index_in_edge
    scatterer, edge = crossings.scatterer[pair], crossings.edge[pair]
    after_edge_at_rest_s = sample_time_s[sample] - crossings.time_s[pair]
    # Taylor coefficients of the pulse, (pair, order): common to all scatterers, or with each one's beam response.
    if scatterer_rows.response is None:
        coefficients = taylor.sum(axis=1).real[edge]
    else:
        response, edge_taylor = scatterer_rows.response[:, crossings.scatterer], taylor[crossings.edge]
        coefficients = np.einsum("fs,sfq->sq", response, edge_taylor, optimize=True).real[pair]
    correction = _crossing_corrections(scatterer_rows, scatterer, after_edge_at_rest_s, coefficients)
    # Several pairs may have the same row and sample, and fancy indexing adds to an element only once: sort the pairs by
    # row and sample, sum each run of equal ones, and add the sums.
    row = scatterer_rows.row[scatterer]
    element = row * out.shape[2] + sample
    order = np.argsort(element, kind="stable")
    run_starts = np.flatnonzero(np.diff(element[order], prepend=-1))
    first = order[run_starts]
    out[row[first], :, sample[first]] += np.add.reduceat(correction[order], run_starts, axis=0)


def _crossing_corrections(
    scatterer_rows: ScattererRows,
    scatterer: Int64Array,
    after_edge_at_rest_s: FloatArray,
    coefficients: FloatArray,
) -> FloatArray:
    """Return the corrections of the echoes where motion moves an edge of a pulse past a sample, (pair, echo).

    A pair is an edge (start or end) and a sample near it. At a crossing the correction is plus or minus the weighted
    pulse, elsewhere 0. ``after_edge_at_rest_s`` (pair,): time of the sample after the edge at rest.
    ``coefficients`` (pair, order): Taylor coefficients of the pulse about its edge, sign reversed at its end.
    """
    # Change of the echo delay by the motion, (pair, echo).
    if len(scatterer_rows.amplitude_s) == 1:
        delay_change_s = scatterer_rows.shape[:, scatterer].T @ scatterer_rows.amplitude_s[0].T
    else:
        amplitude_s = scatterer_rows.amplitude_s[scatterer_rows.row[scatterer]]
        delay_change_s = np.matmul(amplitude_s, scatterer_rows.shape[:, scatterer].T[:, :, None])[:, :, 0]
    # Time of the sample after the moved edge; it overwrites the delays, to save memory.
    after_moved_edge_s = np.subtract(after_edge_at_rest_s[:, None], delay_change_s, out=delay_change_s)
    # The pulse at the sample, by Horner's rule.
    pulse_value = np.zeros_like(after_moved_edge_s)
    for coefficient in coefficients.T[:0:-1]:
        pulse_value += coefficient[:, None]
        pulse_value *= after_moved_edge_s
    pulse_value += coefficients[:, :1]
    # A sample that is after the edge only in motion gains the weighted pulse, one that is after it only at rest loses
    # it, and one on the same side in both cases does not change.
    weight = scatterer_rows.weight[scatterer]
    is_after_at_rest = after_edge_at_rest_s >= 0
    if_after, if_before = np.where(is_after_at_rest, 0.0, weight), np.where(is_after_at_rest, -weight, 0.0)
    pulse_value *= np.where(after_moved_edge_s >= 0, if_after[:, None], if_before[:, None])
    return np.asarray(pulse_value)


def _taylor_term_count(angle_rad: float, tolerance: float) -> int:
    """Return how many Taylor terms n keep the remainder angle^n / n! below ``tolerance``, at most ``_TAYLOR_ORDERS``.

    ``angle_rad``: phase that the pulse's highest frequency gains over the largest time shift of an edge.
    """
    remainder, term_count = angle_rad, 1
    while remainder > tolerance and term_count < _TAYLOR_ORDERS:
        term_count += 1
        remainder *= angle_rad / term_count
    return term_count
