"""Echoes to amplitude and phase by name: one row an estimator."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

from hpe_rig.processing.correlation import cross_correlation
from hpe_rig.processing.echoes import EchoGate, FloatArray, Motion, velocity_between_pulses
from hpe_rig.processing.harmonic import HarmonicFit, least_squares
from hpe_rig.processing.kalman_filter import kalman
from hpe_rig.processing.maximum_likelihood import joint
from hpe_rig.processing.motion import coherent, cross_spectrum, kasai, loupas
from hpe_rig.processing.velocity_chain import velocity_to_harmonics

Estimator = Literal["coherent", "joint", "cross_correlation", "kasai", "loupas", "cross_spectrum"]
ESTIMATORS: tuple[Estimator, ...] = get_args(Estimator)
Harmonic = Literal["least_squares", "kalman"]

MOTION: dict[Estimator, Callable[[EchoGate], Motion]] = {
    "coherent": coherent,
    "cross_correlation": cross_correlation,
    "kasai": kasai,
    "loupas": loupas,
    "cross_spectrum": cross_spectrum,
}
"""The estimators of displacement; ``joint`` has no displacements between echoes and result."""


@dataclass(frozen=True, slots=True)
class Options:
    """What of the estimation can be chosen, apart from the estimator.

    ``background_order``: polynomial fitted along (0 constant, 1 velocity, 2 acceleration, more: drift);
    ``process_noise``: variance of a harmonic state's change per pulse over that of the noise, for "kalman" alone.
    The paper's chain, ``cross_spectrum``, has its own Kalman filter and band-pass and takes neither.
    """

    background_order: int = 0
    harmonic: Harmonic = "least_squares"
    process_noise: float = 0.0


PLAIN = Options()


def estimate(
    echoes: EchoGate,
    frequencies_hz: FloatArray | Sequence[float],
    estimator: Estimator = "coherent",
    also_hz: FloatArray | Sequence[float] = (),
    options: Options = PLAIN,
) -> HarmonicFit:
    """Return amplitude and phase of the motion at every frequency, from all valid pulses.

    ``also_hz`` are frequencies that the motion has as well and that are not wanted: they are fitted along. Raises
    ``ValueError`` for an unknown estimator, and when echoes or pulses cannot carry the estimate.
    """
    if estimator not in ESTIMATORS:
        raise ValueError(f"estimator {estimator!r} does not exist: try one of {', '.join(ESTIMATORS)}")
    if estimator == "joint":
        return joint(echoes, frequencies_hz, also_hz=also_hz, background_order=options.background_order)
    return fit_motion(motion_of(echoes, estimator), frequencies_hz, estimator, also_hz, options)


def motion_of(echoes: EchoGate, estimator: Estimator) -> Motion:
    """Return the displacement of every pulse; raise ``ValueError`` for "joint", which has none, and bad echoes."""
    if estimator not in MOTION:
        raise ValueError(f"{estimator} gives no displacement per pulse: try one of {', '.join(MOTION)}")
    return MOTION[estimator](echoes)


def fit_motion(
    motion: Motion,
    frequencies_hz: FloatArray | Sequence[float],
    estimator: Estimator = "coherent",
    also_hz: FloatArray | Sequence[float] = (),
    options: Options = PLAIN,
) -> HarmonicFit:
    """Return amplitude and phase of a motion by the way that belongs to its estimator."""
    if estimator == "cross_spectrum":
        return velocity_to_harmonics(velocity_between_pulses(motion), frequencies_hz, also_hz=also_hz)
    order = options.background_order
    if options.harmonic == "kalman":
        noise = options.process_noise
        return kalman(motion, frequencies_hz, also_hz=also_hz, background_order=order, process_noise=noise)
    return least_squares(motion, frequencies_hz, also_hz=also_hz, background_order=order)
