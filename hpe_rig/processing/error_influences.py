"""Errors of one shot's complex values by source, with their covariance over frequencies and shots.

The budget (budget.py) states the uncertainty of each value alone. Here every source gets its covariance over all
frequencies, as influences of independent variables of unit variance (result/covariance.py). An influence is the
complex error, m, of each value per unit of a variable:

    noise, trigger jitter    covariance of the fit, of one shot; drift: as well
    aliasing                 error in each medium of the ensemble, common to a run; beyond the ensemble, to repeats
    beam averaging           deviation in each medium of the ensemble: the variables of aliasing
    speckle                  scatterers at one position; to second order as well
    time base                the clocks, common to a run; noise of a shot's displacement
    other sources            of the budget, common to the shots in `COMMON_TO`
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.processing.budget import NO_AVERAGING, SPECKLE_KURTOSIS, ErrorSources
from hpe_rig.processing.harmonics.harmonic_fit import HarmonicFit
from hpe_rig.result import INDEPENDENT_SOURCES, RECTIFIED, Averaging, Component, Estimate, Influence, Scope

NOISE_SOURCES = ("noise", "trigger jitter")
COMMON_TO: dict[str, Scope] = {
    "speckle": "position",
    "beam averaging": "run",
    "gate edge": "position",
    "sound speed": "run",
    "gate off focus": "run",
    "carrier": "position",
    "beam shape": "run",
    "first pulse": "shot",
}
"""Shots that have an error in common, for sources with errors of the same sign at all frequencies of a shot."""


def error_influences(
    fit: HarmonicFit,
    estimates: Sequence[Estimate],
    averaging: Sequence[Averaging | None],
    averaging_of_media: bool,
    error_sources: ErrorSources,
) -> tuple[Influence, ...]:
    """Return the influence of each source of error on the complex amplitudes of ``estimates``, over all frequencies.

    ``estimates`` follow from ``fit``, ``averaging`` (frequency,) and ``error_sources``. ``averaging_of_media``: whether
    that averaging is a mean over the media that the fit leaves probable.
    """
    best = fit if None in averaging or fit.aliasing_corrected is None else fit.aliasing_corrected
    phasor_m = np.array([estimate.phasor_m for estimate in estimates])
    # From phasors of the fit to those of the estimates: beam averaging, and the time zero of stated phases.
    factor = np.array([1 / (estimate.averaging_factor or 1.0) for estimate in estimates])
    factor = factor * np.exp(1j * (np.angle(phasor_m) - best.phase_rad))
    media = list(_media_influences(best, averaging, averaging_of_media, phasor_m, factor))
    clocks = list(_time_base_influences(error_sources, factor))
    influences = [*_noise_influences(best, estimates, factor), *media, *clocks]
    described = {"time base", *NOISE_SOURCES, RECTIFIED, "drift", *(influence.source for influence in media)}
    sources = dict.fromkeys(item.source for estimate in estimates for item in estimate.budget)
    influences += [_budget_influence(source, estimates) for source in sources if source not in described]
    return tuple(item for item in influences if item.source in NOISE_SOURCES or item.influence_m.any())


def _noise_influences(fit: HarmonicFit, estimates: Sequence[Estimate], factor: ComplexArray) -> Iterator[Influence]:
    """Yield the influences of drift, noise and trigger jitter, from the covariance of the fit.

    ``factor`` (frequency,): from phasors of the fit to those of ``estimates``.
    """
    states = slice(2 * factor.size)
    noise_m2 = fit.state_covariance[states, states]
    if fit.aliasing_causes is not None:
        noise_m2 = noise_m2 - fit.aliasing_causes.total_m2
    if fit.drift_m2 is not None:
        noise_m2 = noise_m2 - fit.drift_m2
        yield Influence("drift", _influences_m(fit.drift_m2) * factor[:, None], "shot", "drift")
    influence_m = _influences_m(noise_m2) * factor[:, None]
    # Noise and trigger jitter share this covariance in proportion to their variances in the budget.
    components = {item.source: item for item in estimates[0].budget if item.source in NOISE_SOURCES}
    total_m = math.hypot(*(item.amplitude_m for item in components.values()))
    for source, item in components.items():
        fraction = item.amplitude_m / total_m if total_m else 1.0 / math.sqrt(len(components))
        yield Influence(source, influence_m * fraction, "shot", source, item.degrees_of_freedom)


def _time_base_influences(sources: ErrorSources, factor: ComplexArray) -> Iterator[Influence]:
    """Yield the influences of the clocks' rate error: its part from their accuracy, and its part from noise.

    Noise is in the rate error if it was estimated from the displacement. ``factor`` (frequency,): from phasors of the
    fit to those of the estimates.
    """
    if sources.time_base_m is None:
        return
    influence_m, noise_fraction = (sources.time_base_m * factor)[:, None], 1 - sources.time_base_clock_fraction
    yield Influence("time base", influence_m * math.sqrt(1 - noise_fraction), "run", "clocks")
    if noise_fraction > 0:
        # The degrees of freedom are those of the whole variance; the noise is only this fraction of it.
        degrees_of_freedom = sources.time_base_freedom * noise_fraction**2
        yield Influence("time base", influence_m * math.sqrt(noise_fraction), "shot", "time base", degrees_of_freedom)


def _media_influences(
    fit: HarmonicFit,
    averaging: Sequence[Averaging | None],
    averaging_of_media: bool,
    phasor_m: ComplexArray,
    factor: ComplexArray,
) -> Iterator[Influence]:
    """Yield the influences of the unknown medium, on aliasing and beam averaging, and of speckle.

    Each medium of the ensemble is one variable, common to aliasing and beam averaging. ``phasor_m`` (frequency,): of
    the estimates; ``factor``: from phasors of the fit to these. ``averaging_of_media``: whether ``averaging`` is a mean
    over the media that the fit leaves probable.
    """
    if (causes := fit.aliasing_causes) is not None:
        yield Influence("aliasing", causes.media_influences_m.T * factor[:, None], "run", "medium")
        deviation_m = _influences_m(causes.deviation_m2)
        yield Influence("aliasing", deviation_m * factor[:, None], "setting", "deviation from media")
        if np.any(causes.noise_m2):
            noise_m = _influences_m(np.asarray(causes.noise_m2))
            yield Influence("aliasing", noise_m * factor[:, None], "shot", "aliasing noise")
    items = [NO_AVERAGING if item is None else item for item in averaging]
    # Relative change of the motion with the logarithm of the tracking beam's area, (frequency, medium).
    steepness = np.array([[item.steepness] for item in items])
    if (medium := fit.medium) is not None and averaging_of_media:
        yield Influence("beam averaging", medium.ratio_influences.T * phasor_m[:, None], "run", "medium")
        steepness = medium.steepness_influences.T
    # Speckle changes that area; a phase error of variance s² also raises the amplitude by s²/2.
    first_order = np.array([[item.rule.region_sd] for item in items]) * steepness
    if first_order.any():
        second_order = math.sqrt(SPECKLE_KURTOSIS) / 2 * np.sum(first_order.imag**2, axis=1, keepdims=True)
        yield Influence("speckle", np.hstack([first_order, second_order]) * phasor_m[:, None], "position", "speckle")


def _budget_influence(source: str, estimates: Sequence[Estimate]) -> Influence:
    """Return the influence of a ``source`` by its uncertainties in the budgets of ``estimates``.

    Amplitude and phase errors are separate variables: one pair for all frequencies if the source is in ``COMMON_TO``,
    else a pair for each frequency.
    """
    absent = Component(source, 0.0, 0.0)
    components = [next((item for item in estimate.budget if item.source == source), absent) for estimate in estimates]
    phasor_m = np.array([estimate.phasor_m for estimate in estimates])
    direction = np.exp(1j * np.angle(phasor_m))
    along_m = np.array([item.amplitude_m for item in components]) * direction
    across_m = 1j * np.array([item.phase_rad for item in components]) * phasor_m
    if source in COMMON_TO:
        return Influence(source, np.stack([along_m, across_m], axis=1), COMMON_TO[source], source)
    scope: Scope = "shot" if source in INDEPENDENT_SOURCES else "setting"
    degrees_of_freedom = min(item.degrees_of_freedom for item in components)
    return Influence(source, np.hstack([np.diag(along_m), np.diag(across_m)]), scope, source, degrees_of_freedom)


def _influences_m(covariance_m2: FloatArray) -> ComplexArray:
    """Return complex errors (frequency, variable), m, of independent unit variables that have this covariance.

    ``covariance_m2`` (state, state): of in-phase and quadrature errors of each frequency.
    """
    variances, directions = np.linalg.eigh((covariance_m2 + covariance_m2.T) / 2)
    # Rounding can leave a variance of zero slightly negative.
    root = directions * np.sqrt(np.maximum(variances, 0.0))
    return np.asarray(root[0::2] + 1j * root[1::2])
