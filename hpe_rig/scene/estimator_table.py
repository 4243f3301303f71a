"""Estimators that a scene can name: one row each, with the properties that checks, prediction and figures need.

A row names the estimator's function as text, because scenes are read without NumPy; ``processing.spec_of`` imports it.
Other packages add estimators by entry points (docs/how-to/extend.md).
"""

from __future__ import annotations

import difflib
from dataclasses import KW_ONLY, dataclass
from typing import Final, Literal, get_args

from hpe_rig.extensions import ESTIMATORS as ENTRY_POINTS, installed

Window = Literal["none", "hann"]
HarmonicFitName = Literal["medium_prior", "least_squares", "kalman"]

WINDOW_NOISE: Final[dict[Window, float]] = {"none": 1.0, "hann": 1.5}
"""Increase of the variance of a mean by a window w over N samples, N sum w² / (sum w)²."""


@dataclass(frozen=True, slots=True)
class EstimatorProperties:
    """Name of an estimator and everything that distinguishes it from others, apart from its functions."""

    name: str
    _: KW_ONLY
    function: str = ""
    """Function from echoes to displacement, as "module:name"; empty for estimators of other packages."""
    band_function: str = ""
    """Function from spectra in the band to phase, as "module:name"; empty if the estimator has no such form."""
    gate_window: Window = "none"
    """Taper over the samples of the gate."""
    slow_time_window: Window = "none"
    """Taper over the pulses."""
    reads_peak: bool = False
    """The phase is that of the largest bin of the cross-spectrum, which noise can move, not that of the whole band."""
    by_carrier: bool = False
    """The phase is divided by the carrier frequency, not by the mean frequency of the echoes."""
    steps_add_up: bool = False
    """The displacement is a sum of steps between pulses, so that the noise of each step stays in all later pulses."""
    velocity_chain: bool = False
    """Amplitude and phase come from the paper's chain over velocities, which has no prior of media."""
    label: str = ""
    """Name in figures and tables; by default the estimator's name."""
    published: bool = False
    """The estimator is the paper's, which figures show first."""

    def __post_init__(self) -> None:
        """Use the name as the label if there is no other."""
        object.__setattr__(self, "label", self.label or self.name)

    @property
    def gate_noise(self) -> float:
        """Increase of a pulse's variance by the taper over the gate, as a factor."""
        return WINDOW_NOISE[self.gate_window]

    @property
    def slow_time_noise(self) -> float:
        """Increase of a quadrature's variance by the taper over the pulses, as a factor."""
        return WINDOW_NOISE[self.slow_time_window]

    @property
    def fits_all_at_once(self) -> bool:
        """Whether all frequencies are fitted together, so that resolving them costs noise; otherwise one by one."""
        return self.slow_time_window == "none"


_MOTION: Final = "hpe_rig.processing.motion"
BUILT_IN_ESTIMATORS: Final = {
    row.name: row
    for row in (
        EstimatorProperties(
            "coherent",
            function=f"{_MOTION}.phase_shift:coherent",
            band_function=f"{_MOTION}.phase_shift:coherent_phase",
        ),
        EstimatorProperties("cross_correlation", function=f"{_MOTION}.correlation:cross_correlation"),
        EstimatorProperties("kasai", function=f"{_MOTION}.phase_shift:kasai", by_carrier=True, steps_add_up=True),
        EstimatorProperties("loupas", function=f"{_MOTION}.phase_shift:loupas", steps_add_up=True),
        EstimatorProperties(
            "cross_spectrum",
            function=f"{_MOTION}.spectral_peak:cross_spectrum",
            gate_window="hann",
            slow_time_window="hann",
            reads_peak=True,
            velocity_chain=True,
            label="the paper's chain",
            published=True,
        ),
    )
}
"""Estimators of this package by name, in the order of menus and tables."""

REPLACED_ESTIMATORS: Final = {"joint": "coherent"}
"""Removed estimators and the one to use instead; run files may still name them."""


def estimator_names() -> tuple[str, ...]:
    """Return the names of all estimators: those of this package, then those of other packages."""
    return (*BUILT_IN_ESTIMATORS, *(name for name in installed(ENTRY_POINTS) if name not in BUILT_IN_ESTIMATORS))


def properties_of(name: str) -> EstimatorProperties:
    """Return the properties of an estimator; the defaults for one of another package, which is not imported."""
    return BUILT_IN_ESTIMATORS.get(name) or EstimatorProperties(name)


def checked_estimator(name: str, stored: bool = False) -> str:
    """Return ``name``; raise ``ValueError`` if there is no such estimator.

    In a ``stored`` scene, of a run file, a removed estimator becomes the one that replaces it.
    """
    if stored:
        name = REPLACED_ESTIMATORS.get(name, name)
    # The table first, because listing entry points of other packages is slow.
    if name in BUILT_IN_ESTIMATORS or name in estimator_names():
        return name
    if name in REPLACED_ESTIMATORS:
        hint = f"it was removed, use {REPLACED_ESTIMATORS[name]}; "
    elif name in get_args(HarmonicFitName):
        hint = f"processing.harmonic for this fit (hpe-rig process RUN.h5 --set processing.harmonic={name}); "
    else:
        close = difflib.get_close_matches(name, estimator_names(), n=1)
        hint = f"did you mean {close[0]}? " if close else ""
    raise ValueError(f"{name[:80]!r} is not one of the choices: {hint}one of {', '.join(map(repr, estimator_names()))}")
