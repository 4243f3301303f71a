"""Motion map: amplitude, phase and velocity with their uncertainties, over lines and depths."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from hpe_rig.arrays import ByteArray, FloatArray
from hpe_rig.result.sentence import scale_of
from hpe_rig.result.tables import package_of_extra
from hpe_rig.scene import MIN_LENGTH_M, engineering, plural

if TYPE_CHECKING:
    import xarray
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


class BadPixel(IntEnum):
    """Reason why a pixel has no estimate; 0 for a pixel with one."""

    GOOD = 0
    NOISE = 1
    NO_ECHO = 2
    NOT_FINITE = 3


@dataclass(frozen=True, slots=True)
class MotionMap:
    """Motion of every pixel; NaN where ``bad`` (line, depth) is not 0.

    ``frequency_hz`` (frequency,); ``depth_m`` (depth,); ``line_m`` (line,): lateral offset from the push, or the line's
    number if ``lines_are_placed`` is False. ``amplitude_m`` and ``phase_rad`` (line, depth, frequency) of
    A sin(2 pi f t + phase), positive away from the transducer; ``velocity_m_per_s`` (line, depth) of the remaining
    motion. Their standard uncertainties include noise, decorrelation of the echoes, echo frequency and sound
    speed.
    ``residual_m``: displacement noise of one pulse. ``power``: echo power, in the recording's units squared.
    ``clock_delay_u_s``: standard uncertainty of one delay of all phases by the clocks, part of that of each phase.
    """

    frequency_hz: FloatArray
    line_m: FloatArray
    depth_m: FloatArray
    amplitude_m: FloatArray
    amplitude_uncertainty_m: FloatArray
    phase_rad: FloatArray
    phase_uncertainty_rad: FloatArray
    velocity_m_per_s: FloatArray
    velocity_uncertainty_m_per_s: FloatArray
    residual_m: FloatArray
    power: FloatArray
    bad: ByteArray
    lines_are_placed: bool
    origin: str = ""
    clock_delay_u_s: float = 0.0

    def __str__(self) -> str:
        return "\n".join(self._lines())

    def _lines(self) -> Iterator[str]:
        numbers = self.summary()
        lines, gates = plural(numbers["lines"], "line"), plural(numbers["gates"], "gate")
        yield f"{lines} of {gates}, {numbers['pixels_estimated']} of {self.bad.size} pixels estimated"
        for kind, why in _REASONS.items():
            if count := numbers["pixels_excluded"][kind.name.lower()]:
                yield f"{plural(count, 'pixel')} excluded: {why}"
        for row in numbers["frequencies"]:
            u_m = row["median_amplitude_uncertainty_m"]
            # Values that were computed instead of measured have a residual of rounding errors.
            u_text = "below 1 fm" if u_m < MIN_LENGTH_M else engineering(u_m, "m", 3)
            yield (
                f"{row['frequency_hz']:g} Hz: amplitude {engineering(row['median_amplitude_m'], 'm')} in the median of "
                f"the pixels, {engineering(row['amplitude_at_95_percent_m'], 'm')} at 95 %, "
                f"median u {u_text}"
            )

    def summary(self) -> dict[str, Any]:
        """Return the numbers of pixels and, for each frequency, the amplitudes that the text states."""
        lines, gates = self.bad.shape
        good = self.bad == 0
        frequencies = []
        for index, hz in enumerate(self.frequency_hz.tolist() if good.any() else ()):
            amplitude, u = self.amplitude_m[good, index], self.amplitude_uncertainty_m[good, index]
            frequencies.append(
                {
                    "frequency_hz": hz,
                    "median_amplitude_m": float(np.median(amplitude)),
                    "amplitude_at_95_percent_m": float(np.quantile(amplitude, 0.95)),
                    "median_amplitude_uncertainty_m": float(np.median(u)),
                }
            )
        return {
            "lines": lines,
            "gates": gates,
            "pixels_estimated": int(good.sum()),
            "pixels_excluded": {kind.name.lower(): int((self.bad == kind).sum()) for kind in _REASONS},
            "frequencies": frequencies,
        }

    def to_xarray(self) -> xarray.Dataset:
        """Return an xarray dataset with axes line, depth and frequency, and units; needs the extra 'frames'."""
        dataset = package_of_extra("xarray", "MotionMap.to_xarray").Dataset
        # Amplitudes and phases have a value for each frequency, all other quantities one for each pixel.
        pixel, pixel_and_frequency = ("line", "depth"), ("line", "depth", "frequency")
        variables: dict[str, Any] = {}
        for name, unit in _UNITS.items():
            value = getattr(self, name)
            variables[name] = (pixel_and_frequency if value.ndim == 3 else pixel, value, {"units": unit})
        kinds, names = zip(*((int(kind), kind.name.lower()) for kind in BadPixel), strict=True)
        variables["bad"] = (pixel, self.bad, {"flag_values": list(kinds), "flag_meanings": " ".join(names)})
        line_units = (
            {"units": "m", "long_name": "lateral offset from the push"} if self.lines_are_placed else {"units": "1"}
        )
        coordinates = {
            "line": ("line", self.line_m, line_units),
            "depth": ("depth", self.depth_m, {"units": "m"}),
            "frequency": ("frequency", self.frequency_hz, {"units": "Hz"}),
        }
        attributes = {"title": "Motion map", "source": self.origin}
        return cast("xarray.Dataset", dataset(variables, coordinates, attributes))

    def figure(
        self,
        frequency: int = 0,
        *,
        ax: Sequence[Axes] | None = None,
        figsize: tuple[float, float] = (9.0, 6.5),
    ) -> Figure:
        """Return images of amplitude, phase and u at the frequency of this index, and of velocity; bad pixels blank.

        ``ax``: axes of the four images; ``figsize``: width and height of a new figure, inches.
        """
        from hpe_rig.result.panels import figure_panels

        figure, all_axes = figure_panels(2, 2, ax, figsize)
        amplitude, u = self.amplitude_m[..., frequency], self.amplitude_uncertainty_m[..., frequency]
        has_pixels = bool(np.isfinite(amplitude).any())
        max_amplitude_m = float(np.nanquantile(amplitude, 0.98)) if has_pixels else 1e-9
        max_speed = float(np.nanquantile(np.abs(self.velocity_m_per_s), 0.98)) if has_pixels else 1e-6
        scale_m, unit = scale_of(max_amplitude_m)
        scale, speed_unit = scale_of(max_speed, "m/s")
        speed_limit = max_speed / scale
        panels = (
            (amplitude / scale_m, f"amplitude / {unit}", "viridis", 0.0, max_amplitude_m / scale_m),
            (np.degrees(self.phase_rad[..., frequency]), "phase / deg", "twilight", -180.0, 180.0),
            (u / scale_m, f"u of the amplitude / {unit}", "magma", 0.0, None),
            (self.velocity_m_per_s / scale, f"velocity / ({speed_unit})", "RdBu_r", -speed_limit, speed_limit),
        )
        # Lines without a position count from 1, as in the option --lines.
        line = self.line_m * 1e3 if self.lines_are_placed else self.line_m + 1
        extent = (*_edges(line), *_edges(self.depth_m * 1e3)[::-1])
        for axes, (values, label, colours, low, high) in zip(all_axes, panels, strict=True):
            limit = float(np.nanquantile(values, 0.98)) if high is None and np.isfinite(values).any() else high
            image = axes.imshow(values.T, extent=extent, aspect="auto", cmap=colours, vmin=low, vmax=limit)
            axes.set_facecolor("0.85")
            figure.colorbar(image, ax=axes, label=label.replace("um", "µm"))
            axes.set(xlabel="lateral offset / mm" if self.lines_are_placed else "line", ylabel="depth / mm")
        source = [self.origin.partition(", SHA")[0]] if self.origin else []
        title = ", ".join([f"{self.frequency_hz[frequency]:g} Hz", *source])
        if ax is None:
            figure.suptitle(title, fontsize="medium", wrap=True)
        return figure


_UNITS = {
    "amplitude_m": "m",
    "amplitude_uncertainty_m": "m",
    "phase_rad": "rad",
    "phase_uncertainty_rad": "rad",
    "velocity_m_per_s": "m/s",
    "velocity_uncertainty_m_per_s": "m/s",
    "residual_m": "m",
    "power": "1",
}
_REASONS = {
    BadPixel.NOISE: "noise, or motion of more than a quarter wavelength between pulses",
    BadPixel.NO_ECHO: "no echo",
    BadPixel.NOT_FINITE: "samples that are not finite",
}


def _edges(centre: FloatArray) -> tuple[float, float]:
    """Return the outer edges of evenly spaced pixels."""
    half = float(np.diff(centre).mean()) / 2 if centre.size > 1 else 0.5
    return float(centre[0]) - half, float(centre[-1]) + half
