"""Dispersion of shear waves from runs: near-field fit, other methods, and their errors as the exact field predicts."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hpe_rig.arrays import BoolArray, ComplexArray, FloatArray
from hpe_rig.moduli.inversion import REJECTED
from hpe_rig.moduli.run_vibrations import Source, vibrations_of
from hpe_rig.moduli.scene_geometry import WIDTH_UNCERTAINTY, push_of
from hpe_rig.moduli.vibration_model import Push, Vibration
from hpe_rig.moduli.wave_methods import METHODS, LateralField, MethodCurve, WaveMethod
from hpe_rig.moduli.wavenumber_fit import DispersionCurve, WavenumberFit, fit_wavenumbers
from hpe_rig.result import csv_text, json_values, object_schema, text_table, titled, with_u

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MIN_OFFSETS = 3
"""Lateral offsets that a frequency needs: two determine a wave number, a third one its misfit."""
DB_PER_CM_PER_NP_PER_M = 20 / math.log(10) / 100
NEAR_FIELD = "near field"


@dataclass(frozen=True, slots=True, eq=False)
class DispersionResult:
    """Phase velocity and attenuation of shear waves at every harmonic, from several lateral offsets.

    ``near_field``: fit of the exact field, one complex wave number for each frequency; ``chi_square`` with ``freedom``
    degrees of freedom and its ``significance``. ``methods``: those for plane and cylindrical waves, for comparison.
    ``offset_m`` (offset,): distances from the push. ``omitted``: data and values that are left out, in words.
    """

    title: str
    simulated: bool
    offset_m: FloatArray
    near_field: DispersionCurve
    chi_square: float
    freedom: int
    significance: float
    methods: tuple[MethodCurve, ...]
    omitted: tuple[str, ...]

    def __str__(self) -> str:
        """Return tables of phase velocity and attenuation, and the omitted data."""
        return "\n".join(_lines(self))

    def rows(self) -> list[dict[str, Any]]:
        """Return one row for each method and frequency, with the columns of the CSV output; None without a value.

        A method has phase velocity or attenuation; the fit of the near field has both and no bias.
        """
        near = self.near_field
        nothing = np.full(near.frequency_hz.size, np.nan)
        speed = near.phase_velocity_m_per_s, near.phase_velocity_uncertainty_m_per_s, nothing
        attenuation = near.attenuation_np_per_m, near.attenuation_uncertainty_np_per_m, nothing
        curves = [(NEAR_FIELD, speed, attenuation)]
        for method in self.methods:
            values, empty = (method.value, method.uncertainty, method.bias), (nothing, nothing, nothing)
            curves.append((method.name, empty, values) if method.is_attenuation else (method.name, values, empty))
        rows = list[dict[str, Any]]()
        for name, speed, attenuation in curves:
            in_db_per_cm = (column * DB_PER_CM_PER_NP_PER_M for column in attenuation[:2])
            # In the order of ``COLUMNS``, (column, frequency).
            table = np.stack([*speed, *attenuation, *in_db_per_cm])
            for hz, values_at_hz in zip(near.frequency_hz.tolist(), table.T.tolist(), strict=True):
                cells = (value if math.isfinite(value) else None for value in values_at_hz)
                rows.append({"method": name, "frequency_hz": hz, **dict(zip(COLUMNS, cells, strict=True))})
        return rows

    def to_csv(self) -> str:
        """Return ``rows`` as CSV."""
        return csv_text(self.rows())

    def as_dict(self) -> dict[str, Any]:
        """Return the result as a dictionary of plain values for JSON, with the keys of ``dispersion_schema``."""
        names = "title", "simulated", "chi_square", "freedom", "significance", "omitted"
        plain: dict[str, Any] = json_values({name: getattr(self, name) for name in names})
        return plain | {"offset_m": self.offset_m.tolist(), "rows": self.rows()}

    def figure(self, *, ax: Sequence[Axes] | None = None, figsize: tuple[float, float] | None = None) -> Figure:
        """Return a figure of phase velocity and attenuation over frequency.

        ``ax``: axes for the two quantities; ``figsize``: width and height of a new figure, inches.
        """
        from hpe_rig.moduli.dispersion_figure import PAGE_SIZE_IN, dispersion_figure

        size = figsize or PAGE_SIZE_IN
        return dispersion_figure(self.near_field, self.methods, simulated=self.simulated, ax=ax, figsize=size)

    def _repr_html_(self) -> str:
        """Return figure and text for a notebook."""
        from html import escape

        from hpe_rig.result import image, picture

        title = "Phase velocity and attenuation"
        return f"{image(picture(self.figure(), 'dispersion', title, self.title))}<pre>{escape(str(self))}</pre>"


def dispersion_of(
    sources: Sequence[Source],
    estimator: str | None = None,
    width_uncertainty: float = WIDTH_UNCERTAINTY,
    common_amplitude: bool = True,
) -> DispersionResult:
    """Return phase velocity and attenuation of shear waves from the vibrations of the runs ``sources``.

    Arguments and errors are those of ``moduli_of``. Raises ``ValueError`` also if no frequency is significant at
    ``MIN_OFFSETS`` lateral offsets.
    """
    push = push_of([source.scene for source in sources], width_uncertainty)
    vibrations, omitted = vibrations_of(sources, estimator, common_amplitude)
    return dispersion_of_vibrations(
        vibrations,
        push,
        title=sources[0].scene.title,
        simulated=any(source.stored.simulated for source in sources),
        omitted=omitted,
    )


def dispersion_of_vibrations(
    vibrations: Sequence[Vibration],
    push: Push,
    title: str = "",
    *,
    simulated: bool = False,
    omitted: Sequence[str] = (),
) -> DispersionResult:
    """Return phase velocity and attenuation of shear waves from ``vibrations`` under ``push``.

    ``near_field`` of the result is fitted with the exact field of the push; ``methods`` assume plane or cylindrical
    waves. ``omitted``: data that were left out before, in words. Raises ``ValueError`` if no frequency has vibrations
    at ``MIN_OFFSETS`` lateral offsets, and as ``fit_wavenumbers``.
    """
    selected, too_few = _at_enough_offsets(vibrations, omitted)
    fit = fit_wavenumbers(selected, push)
    grid = _LateralGrid.from_vibrations(selected, fit)
    curves, missing = zip(*(_method_curve(method, grid, fit.curve) for method in METHODS), strict=True)
    return DispersionResult(
        title=title,
        simulated=simulated,
        offset_m=np.unique([abs(vibration.lateral_m) for vibration in selected]),
        near_field=fit.curve,
        chi_square=fit.chi_square,
        freedom=fit.freedom,
        significance=fit.significance,
        methods=curves,
        omitted=(*omitted, *too_few, *(line for lines in missing for line in lines)),
    )


def _at_enough_offsets(
    vibrations: Sequence[Vibration], omitted: Sequence[str]
) -> tuple[list[Vibration], Iterator[str]]:
    """Return the vibrations at the frequencies with enough offsets, and the omitted frequencies in words."""
    offsets_m: dict[float, set[float]] = {}
    for vibration in vibrations:
        for hz in vibration.frequency_hz.tolist():
            offsets_m.setdefault(hz, set()).add(round(abs(vibration.lateral_m), 9))
    enough = [hz for hz, offsets in offsets_m.items() if len(offsets) >= MIN_OFFSETS]
    if not enough:
        offsets_mm = sorted({round(abs(vibration.lateral_m) * 1e3, 6) for vibration in vibrations})
        reason = (
            f"no frequency is significant at {MIN_OFFSETS} lateral offsets, which a wave number and its misfit need; "
            f"offsets with a vibration: {', '.join(f'{offset:g} mm' for offset in offsets_mm) or 'none'}. Try: more "
            "values of sweep.lateral_offset_m, more run files, or a stronger push"
        )
        raise ValueError("; ".join([reason, *omitted]))
    total = len(set.union(*offsets_m.values()))
    too_few = (
        f"{hz:g} Hz: significant at {len(offsets_m[hz])} of {total} offsets" for hz in offsets_m if hz not in enough
    )
    at_enough = (vibration.at_frequencies(np.isin(vibration.frequency_hz, enough)) for vibration in vibrations)
    return [vibration for vibration in at_enough if vibration.frequency_hz.size], too_few


@dataclass(frozen=True, slots=True, eq=False)
class _LateralGrid:
    """Measured, exact and perturbed fields on a grid of offsets beside the push and frequencies.

    ``phasors_m`` (field, offset, frequency): those of the measured field, of the exact field in the fitted medium, then
    of the measured field plus, and minus, each of its one-sigma errors. ``present`` (offset, frequency): whether it was
    measured. ``has_free_gains``: amplitudes at different offsets do not compare.
    """

    offset_m: FloatArray
    frequency_hz: FloatArray
    phasors_m: ComplexArray
    present: BoolArray
    has_free_gains: bool

    @classmethod
    def from_vibrations(cls, vibrations: Sequence[Vibration], fit: WavenumberFit) -> _LateralGrid:
        """Return the fields of the gate nearest to the focus at every lateral offset but 0, by ascending distance."""
        # Index of the nearest gate's vibration, by position and offset; then by distance from the push.
        nearest: dict[tuple[str, float], int] = {}
        for index, vibration in sorted(enumerate(vibrations), key=lambda item: abs(item[1].axial_m)):
            if vibration.lateral_m:
                nearest.setdefault((vibration.position, vibration.lateral_m), index)
        selected = sorted(nearest.values(), key=lambda index: (abs(vibrations[index].lateral_m), index))
        frequency_hz, error_count = fit.curve.frequency_hz, fit.error_m[0].shape[1]
        phasors_m = np.zeros((2 + 2 * error_count, len(selected), frequency_hz.size), np.complex128)
        present = np.zeros(phasors_m.shape[1:], np.bool_)
        for offset, index in enumerate(selected):
            frequencies = np.searchsorted(frequency_hz, vibrations[index].frequency_hz)
            # Measured phasors (frequency,), and their one-sigma errors (error source, frequency).
            measured_m, error_m = vibrations[index].phasor_m, fit.error_m[index].T
            fields_m = [measured_m, fit.nominal_m[index], *measured_m + error_m, *measured_m - error_m]
            phasors_m[:, offset, frequencies] = fields_m
            present[offset, frequencies] = True
        offset_m = np.array([round(abs(vibrations[index].lateral_m), 9) for index in selected])
        has_free_gains = any(vibrations[index].has_free_gain for index in selected)
        return cls(offset_m, frequency_hz, phasors_m, present, has_free_gains)

    def gap_m(self, frequency: int) -> float:
        """Return the largest distance of neighbouring offsets, infinite for fewer than ``MIN_OFFSETS``."""
        offset_m = self.offset_m[self.present[:, frequency]]
        return float(np.diff(offset_m).max()) if np.unique(offset_m).size >= MIN_OFFSETS else math.inf


def _method_curve(method: WaveMethod, grid: _LateralGrid, curve: DispersionCurve) -> tuple[MethodCurve, list[str]]:
    """Return the results of ``method`` with uncertainties and predicted bias, and its missing values in words.

    ``curve``: phase velocity and attenuation fitted with the exact field.
    """
    if method.is_attenuation and grid.has_free_gains:
        nothing = np.full(curve.frequency_hz.size, np.nan)
        result = MethodCurve(method.name, method.is_attenuation, nothing, nothing, nothing, nothing)
        return result, [f"{method.name}: the amplitude at every offset is free, so that its decay is unknown"]
    # Frequencies (frequency,) with offsets that are near enough for the method.
    half_wave_m = curve.phase_velocity_m_per_s / curve.frequency_hz / 2
    gap_m = np.array([grid.gap_m(index) for index in range(curve.frequency_hz.size)])
    sampled = gap_m <= half_wave_m if method.needs_sampling else np.isfinite(gap_m)
    # Results (field, frequency) for the measured field, the exact one, and the measured one plus and minus each error.
    values = np.full((len(grid.phasors_m), curve.frequency_hz.size), np.nan)
    if sampled.any():
        phasors_m, present = grid.phasors_m[..., sampled], grid.present[:, sampled]
        values[:, sampled] = method.estimate(
            LateralField(grid.offset_m, grid.frequency_hz[sampled], phasors_m, present)
        )
    measured, predicted, plus, minus = values[0], values[1], *np.split(values[2:], 2)
    # Half the difference of the results at plus and minus one sigma: GUM (JCGM 100:2008), 5.1.3, note 2.
    uncertainty = np.sqrt(np.sum(((plus - minus) / 2) ** 2, axis=0))
    near_field = curve.attenuation_np_per_m if method.is_attenuation else curve.phase_velocity_m_per_s
    result = MethodCurve(method.name, method.is_attenuation, measured, uncertainty, predicted, predicted - near_field)
    return result, list(_missing_values(result, curve.frequency_hz, sampled, gap_m))


def _missing_values(
    result: MethodCurve, frequency_hz: FloatArray, sampled: BoolArray, gap_m: FloatArray
) -> Iterator[str]:
    """Yield why ``result`` has no value or no u at some frequencies. ``sampled``: whether offsets are near enough."""
    few_offsets, coarse = ~np.isfinite(gap_m), ~sampled & np.isfinite(gap_m)
    no_wave = sampled & ~np.isfinite(result.value)
    no_u = np.isfinite(result.value) & ~np.isfinite(result.uncertainty)
    reasons = (
        (few_offsets, f"fewer than {MIN_OFFSETS} offsets beside the push"),
        (
            coarse,
            f"offsets up to {gap_m[coarse].max(initial=0) * 1e3:.3g} mm apart, more than half a wavelength, so that "
            "phases are ambiguous. Try: smaller steps of the lateral offset",
        ),
        (no_wave, "no outward wave: the phase does not fall with distance"),
        (no_u, "u is undetermined: an error of one standard uncertainty leaves no outward wave"),
    )
    for where, reason in reasons:
        if where.any():
            yield f"{result.name} at {', '.join(f'{hz:g}' for hz in frequency_hz[where])} Hz: {reason}"


COLUMNS = (
    "phase_velocity_m_per_s",
    "phase_velocity_uncertainty_m_per_s",
    "phase_velocity_bias_m_per_s",
    "attenuation_np_per_m",
    "attenuation_uncertainty_np_per_m",
    "attenuation_bias_np_per_m",
    "attenuation_db_per_cm",
    "attenuation_uncertainty_db_per_cm",
)
"""Columns of a row after method and frequency. The bias is predicted by the exact field."""


def dispersion_schema() -> dict[str, Any]:
    """Return the JSON schema of the output of ``hpe-rig dispersion --json``."""
    number = {"anyOf": [{"type": "number"}, {"type": "null"}]}
    row = object_schema(
        "One method at one frequency; null without a value. The bias is predicted by the exact field.",
        {"method": str, "frequency_hz": float, **dict.fromkeys(COLUMNS, number)},
    )
    result = {
        "title": str,
        "simulated": bool,
        "chi_square": float,
        "freedom": int,
        "significance": float,
        "omitted": tuple[str, ...],
        "offset_m": tuple[float, ...],
        "rows": {"type": "array", "items": row},
    }
    return titled("Dispersion of hpe-rig", object_schema(DispersionResult.__doc__ or "", result))


def _lines(result: DispersionResult) -> Iterator[str]:
    """Yield the lines of a result's text: tables of phase velocity and attenuation, and the omitted data."""
    near = result.near_field
    yield result.title
    source = "SIMULATED, " if result.simulated else ""
    offsets_mm = ", ".join(f"{offset * 1e3:.4g}" for offset in result.offset_m)
    yield f"{source}lateral offsets {offsets_mm} mm, {near.frequency_hz.size} frequencies"
    chi_square = f"chi-square {result.chi_square:.4g}, {result.freedom} degrees of freedom"
    yield f"near field: exact field with one wave number for each frequency ({chi_square})"
    if result.significance < REJECTED:
        yield "WARNING the near field does not explain the vibrations. Try: check widths, lateral offsets and symmetry"
    yield "other methods: value (error of the method, predicted from the exact field); uncertainties: --csv"
    speed = near.phase_velocity_m_per_s, near.phase_velocity_uncertainty_m_per_s
    attenuation = near.attenuation_np_per_m, near.attenuation_uncertainty_np_per_m
    for is_attenuation, title, (value, uncertainty) in (
        (False, "phase velocity (m/s)", speed),
        (True, "attenuation (Np/m)", attenuation),
    ):
        methods = [method for method in result.methods if method.is_attenuation == is_attenuation]
        columns = {
            "Hz": [f"{hz:g}" for hz in near.frequency_hz],
            NEAR_FIELD: [with_u(*pair) for pair in zip(value, uncertainty, strict=True)],
        }
        if is_attenuation:
            db_per_cm = zip(value * DB_PER_CM_PER_NP_PER_M, uncertainty * DB_PER_CM_PER_NP_PER_M, strict=True)
            columns["(dB/cm)"] = [with_u(*pair) for pair in db_per_cm]
        columns |= {
            method.name: [_with_bias(method, value, index) for index in range(value.size)] for method in methods
        }
        yield ""
        yield title
        yield text_table(list(columns), zip(*columns.values(), strict=True), words=0)
    if result.omitted:
        yield ""
    yield from (f"omitted: {line}" for line in result.omitted)


def _with_bias(method: MethodCurve, near_field: FloatArray, index: int) -> str:
    """Return a value of ``method`` as text, in brackets its predicted bias in percent of the ``near_field`` value."""
    if not math.isfinite(method.value[index]):
        return "-"
    bias = 100 * method.bias[index] / near_field[index] if near_field[index] else math.nan
    bias_text = f"{bias:+.1f} %" if math.isfinite(bias) else "-"
    u = method.uncertainty[index]
    value = with_u(method.value[index], u).partition(" ")[0] if math.isfinite(u) else f"{method.value[index]:.3g}, no u"
    return f"{value} ({bias_text})"
