"""The result of a measurement with its tables and figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hpe_rig.result.covariance import Covariance, covariance_of
from hpe_rig.result.result_data import ResultData
from hpe_rig.result.rows import result_frame, result_text

if TYPE_CHECKING:
    import pandas as pd
    import xarray
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from hpe_rig.result.figure_kind import FigureKind


@dataclass(frozen=True, slots=True)
class Result(ResultData):
    """The result of a run, or of other echoes (``hpe_rig.estimate``).

    ``run_file`` is "" without one. ``omitted``: stages that the scene does not need, and the reason. ``run_time_s``:
    wall time by stage. ``simulated_specimen`` names the default specimen, None if the scene describes one or needs
    none. ``shots_without_result``: shots without an estimate, counted from 1, and the reason. ``notes`` are those of
    the scene. ``provenance``: who measured, when and where. ``imported``: file and hash of imported records, else None.
    ``conditions``: range of each condition over the run.

    >>> print(result)
    >>> result.shots[0].estimates[0].amplitude_m
    >>> result.to_frame().to_csv("result.csv")
    >>> result.to_xarray().displacement_m.sel(shot=1)
    >>> result.covariance().combined([[1, -1]])
    >>> result.figure().savefig("result.pdf")
    """

    def __str__(self) -> str:
        """Return amplitude and phase with standard uncertainties as a table, a row for each shot and frequency."""
        return result_text(self)

    def to_frame(self) -> pd.DataFrame:
        """Return a pandas frame, a row for each shot and frequency; SI units in the column names, None for unknown.

        Gates over depth have additional rows with ``gate_depth_m``. Raises ``ModuleNotFoundError`` that names the extra
        if pandas is not installed.
        """
        return result_frame(self)

    def to_xarray(self) -> xarray.Dataset:
        """Return an xarray Dataset: estimates over (shot, frequency), displacement, model and residual over pulses.

        Units are attributes, the settings of each shot are coordinates, notes are attributes of the dataset. Raises
        ``ModuleNotFoundError`` that names the extra if xarray is not installed.
        """
        from hpe_rig.result.grid import result_dataset

        return result_dataset(self)

    def covariance(self, *further_results: Result) -> Covariance:
        """Return the complex values of all shots and frequencies with the errors that they have in common.

        ``further_results``: those of other runs in the same medium; their shots follow. Errors of medium, sound speed
        and beams are common to all these runs; noise, speckle and gate edges are not.
        """
        if wrong := [type(result).__name__ for result in further_results if not isinstance(result, ResultData)]:
            raise TypeError(f"covariance expects results of further runs, not {', '.join(wrong)}")
        return covariance_of([result.shots for result in (self, *further_results)])

    def to_gtc(self, *further_results: Result) -> tuple[tuple[Any, ...], ...]:
        """Return the complex values as uncertain complex numbers of GTC, one tuple of frequencies for each shot.

        ``further_results``: as for ``covariance``. Ratios, differences and any other calculation with them have the
        right u, and GTC can archive them. Raises ``ModuleNotFoundError`` that names the extra if GTC is not installed.
        """
        from hpe_rig.result.uncertain_numbers import uncertain_numbers

        return uncertain_numbers(self.covariance(*further_results))

    def figure(
        self,
        kind: FigureKind = "spectrum",
        *,
        frequencies_hz: Sequence[float] | None = None,
        ax: Axes | Sequence[Axes] | None = None,
        figsize: tuple[float, float] | None = None,
    ) -> Figure:
        """Return a matplotlib figure, one curve for each setting, with bars of 2 u; repeats are averaged.

        ``kind``: "spectrum" (amplitude and phase over frequency), "drive" (over the relative force), "distance" (over
        the lateral offset), "profile" (over depth) or "displacement" (over time, largest motion). ``frequencies_hz``:
        those to draw, None for all. ``ax``: axes to draw on, one for "displacement", else two. ``figsize``: width and
        height, inches; without it and ``ax``, rcParams plus the legend. Raises ``ValueError`` if the result lacks the
        data of ``kind``.
        """
        from hpe_rig.result.figure import result_figure

        return result_figure(self, kind, frequencies_hz=frequencies_hz, ax=ax, figsize=figsize)

    def _repr_html_(self) -> str:
        """Return figure and tables for a notebook."""
        from hpe_rig.result.html_repr import result_html

        return result_html(self)
