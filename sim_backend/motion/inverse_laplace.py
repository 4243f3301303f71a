"""Inverse Laplace transform of a transfer function: its step response at any time, tabulated in panels of log time.

    S(t) = 1/(2 pi j) * integral of exp(s t) U(s)/s ds,    s(x) = (m/t0) (1 + sin(j x - alpha))

One hyperbola serves t0 to 4 t0. U must be analytic to the right of it: off the negative real axis and, where it grows
(an elastic medium's does like exp(s^2)), not nearer to that axis than 45 degrees: that sets alpha. The error falls
geometrically with the nodes; 32 give 3e-13 (Weideman and Trefethen, Math. Comp. 76, 2007, for the method;
docs/theory/medium.md, section 4).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sim_backend.arrays import ComplexArray, FloatArray, Int64Array

# Each panel ends at four times its begin: as far as one hyperbola serves.
_RATIO = 4.0
_DEGREES = 24
_FIRST_S = 1e-12
_LAST_S = 1e4


@dataclass(frozen=True, slots=True)
class Contour:
    """A hyperbola: nodes above the real axis, their range of x, height m and angle alpha."""

    nodes: int
    span: float
    height: float
    alpha: float


AXIS_CONTOUR = Contour(32, 3.5, 3.0, 0.65)
FIELD_CONTOUR = Contour(40, 4.6, 1.0, 0.35)
"""Nearer to the imaginary axis, for transfer functions that are not continued as far; 2e-8."""


@dataclass(frozen=True, slots=True)
class Panels:
    """Step responses tabulated as Chebyshev series in time, panel by panel, each four times as long as the last."""

    coefficient: FloatArray
    """(degree, panel, response)."""

    @property
    def begins_s(self) -> FloatArray:
        """Begin of every panel, (panel,)."""
        return np.asarray(_FIRST_S * _RATIO ** np.arange(self.coefficient.shape[1]))

    @property
    def end_s(self) -> float:
        """End of the last panel."""
        return float(_FIRST_S * _RATIO ** self.coefficient.shape[1])

    def at(self, time_s: FloatArray) -> FloatArray:
        """Return the responses at ``time_s``, shape of it and then (response,).

        Exactly 0 up to the onset; before the first panel inertia alone acts, so it goes with the square of time;
        beyond the last it keeps its last value.
        """
        time_s = np.asarray(time_s, dtype=np.float64)
        late_s = np.clip(time_s, _FIRST_S, self.end_s)
        last = self.coefficient.shape[1] - 1
        # Which panel, and where in it from -1 to 1; rounding at a panel's end is harmless, its series goes on.
        panel = np.clip(np.log(late_s / _FIRST_S) / np.log(_RATIO), 0, last).astype(np.int64)
        x = 2 * (late_s / (_FIRST_S * _RATIO**panel) - 1) / (_RATIO - 1) - 1
        value = _clenshaw(self.coefficient, panel, x[..., None])
        early = np.clip(time_s / _FIRST_S, 0.0, 1.0) ** 2
        return np.asarray(value * early[..., None])


def panels_of(
    transfer: Callable[[ComplexArray], ComplexArray], contour: Contour = AXIS_CONTOUR, degrees: int = _DEGREES
) -> Panels:
    """Return the table of the responses whose ``transfer`` gives (s, response) for s (s,), from 1 ps to 10^4 s."""
    count = int(np.ceil(np.log(_LAST_S / _FIRST_S) / np.log(_RATIO)))
    begin_s = _FIRST_S * _RATIO ** np.arange(count)
    s, weight = _hyperbola(contour)
    # (panel, node, response): every panel's hyperbola is the same one, scaled by its begin.
    value = transfer((s / begin_s[:, None]).ravel()).reshape(count, contour.nodes, -1)
    angle = (np.arange(degrees) + 0.5) * np.pi / degrees
    # Chebyshev points of a panel, in units of its begin: 1 to 4.
    place = 1 + (_RATIO - 1) * (np.cos(angle) + 1) / 2
    # (time, node) is the same for every panel: time is counted in units of its begin.
    to_time = np.exp(np.outer(place, s)) * weight
    samples = np.einsum("tn,pnr->tpr", to_time, value, optimize=True).real
    to_coefficients = np.cos(np.outer(np.arange(degrees), angle)) * (2 / degrees)
    to_coefficients[0] /= 2
    return Panels(np.einsum("dt,tpr->dpr", to_coefficients, samples, optimize=True))


def _hyperbola(contour: Contour) -> tuple[ComplexArray, ComplexArray]:
    """Return s and the weight of U(s), (node,), for times 1 to 4; the half above the real axis, counted twice."""
    step = contour.span / contour.nodes
    x = (np.arange(contour.nodes) + 0.5) * step
    s = contour.height * (1 + np.sin(1j * x - contour.alpha))
    return s, step / np.pi * contour.height * np.cos(1j * x - contour.alpha) / s


def _clenshaw(coefficient: FloatArray, panel: Int64Array, x: FloatArray) -> FloatArray:
    """Return each panel's Chebyshev series at ``x`` by Clenshaw's recurrence, (*panel, response).

    Row by row: numpy's chebval would gather (degree, time, response) at once.
    """
    one = np.zeros_like(x)
    two = np.zeros_like(x)
    twice = 2 * x
    for row in coefficient[:0:-1]:
        one, two = row[panel] + twice * one - two, one
    return np.asarray(coefficient[0][panel] + x * one - two)
