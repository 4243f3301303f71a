"""Inverse Laplace transform of a transfer function: its step response, tabulated in panels of logarithmic time.

    S(t) = 1/(2 pi j) * integral of exp(s t) U(s)/s ds,    s(x) = (m/t0) (1 + sin(j x - alpha))

    S, U      step response; transfer function
    s, t      complex frequency, 1/s; time, s
    x         parameter along the contour, a hyperbola of height m and angle alpha
    t0        begin of a panel, s; one hyperbola serves t0 to 4 t0

U must be analytic to the right of the contour, thus away from the negative real axis. Where U grows (like exp(s²) for
an elastic medium), it must be no nearer to that axis than 45 degrees, which fixes alpha. The error falls geometrically
with the nodes; 32 nodes give 3e-13. Method: Weideman and Trefethen, Math. Comp. 76, 2007; docs/explanation/medium.md,
section 4.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.chebyshev import chebpts1, chebvander

from sim_backend.arrays import ComplexArray, FloatArray, Int64Array

_PANEL_RATIO = 4.0
"""End over begin of a panel: as long as one hyperbola serves."""
DEGREES = 24  # Chebyshev coefficients of a panel
# Begin of the first panel, and a time that the last panel contains.
_FIRST_S = 1e-12
_LAST_S = 1e4


@dataclass(frozen=True, slots=True)
class Contour:
    """A hyperbola: number of nodes above the real axis, their range of x, height m and angle alpha."""

    nodes: int
    span: float
    height: float
    alpha: float


AXIS_CONTOUR = Contour(32, 3.5, 3.0, 0.65)
FIELD_CONTOUR = Contour(40, 4.6, 1.0, 0.35)
"""Nearer to the imaginary axis, for transfer functions with a smaller analytic region; exact to 2e-8."""


@dataclass(frozen=True, slots=True)
class Panels:
    """Step responses tabulated as Chebyshev series in time, in panels that each are four times as long as the last."""

    coefficient: FloatArray
    """(degree, panel, response)."""

    @property
    def begins_s(self) -> FloatArray:
        """Begin of every panel, (panel,)."""
        return np.asarray(_FIRST_S * _PANEL_RATIO ** np.arange(self.coefficient.shape[1]))

    @property
    def end_s(self) -> float:
        """End of the last panel."""
        return float(_FIRST_S * _PANEL_RATIO ** self.coefficient.shape[1])

    def at(self, time_s: FloatArray) -> FloatArray:
        """Return the tabulated step responses at ``time_s``, (*time, response).

        They are exactly 0 up to the onset. Before the first panel only inertia acts, so they grow with the square of
        time. After the last panel they keep their last value.
        """
        time_s = np.asarray(time_s, dtype=np.float64)
        in_table_s = np.clip(time_s, _FIRST_S, self.end_s)
        last = self.coefficient.shape[1] - 1
        # Panel, and position in it from -1 to 1. Rounding at the end of a panel is harmless: its series continues.
        panel = np.clip(np.log(in_table_s / _FIRST_S) / np.log(_PANEL_RATIO), 0, last).astype(np.int64)
        position = 2 * (in_table_s / (_FIRST_S * _PANEL_RATIO**panel) - 1) / (_PANEL_RATIO - 1) - 1
        value = _chebyshev_sum(self.coefficient, panel, position[..., None])
        # Below the first panel the response grows with the square of time.
        onset_factor = np.clip(time_s / _FIRST_S, 0.0, 1.0) ** 2
        return np.asarray(value * onset_factor[..., None])


def panels_of(
    transfer: Callable[[ComplexArray], ComplexArray], contour: Contour = AXIS_CONTOUR, degrees: int = DEGREES
) -> Panels:
    """Return step responses from 1 ps to 10^4 s, tabulated in panels of time, from their Laplace transform.

    ``transfer`` returns the transform U, (frequency, response), at complex frequencies (frequency,). ``contour``: of
    the inverse transform. ``degrees``: number of Chebyshev coefficients of a panel.
    """
    count = int(np.ceil(np.log(_LAST_S / _FIRST_S) / np.log(_PANEL_RATIO)))
    begin_s = _FIRST_S * _PANEL_RATIO ** np.arange(count)
    # The hyperbola for a panel that begins at 1; that of a later panel is smaller in proportion.
    s, weight = _hyperbola(contour)
    transform = transfer((s / begin_s[:, None]).ravel()).reshape(count, contour.nodes, -1)
    # Chebyshev points in units of a panel's begin, 1 to 4, so that exp(s t) is common to all panels.
    time = 1 + (_PANEL_RATIO - 1) * (chebpts1(degrees) + 1) / 2
    inverse = np.exp(np.outer(time, s)) * weight
    # The inverse transform is a sum over the nodes n of the hyperbola. Its values at the times t of a panel give the
    # Chebyshev coefficients of degree d; p: panel, r: response.
    values = np.einsum("tn,pnr->tpr", inverse, transform, optimize=True).real
    return Panels(np.einsum("dt,tpr->dpr", chebyshev_matrix(degrees), values, optimize=True))


def chebyshev_matrix(count: int) -> FloatArray:
    """Return the matrix from values at the Chebyshev points, ascending, to Chebyshev coefficients, (degree, point)."""
    # Chebyshev polynomials are orthogonal in the sum over these points: the inverse is a scaled transpose.
    matrix = chebvander(chebpts1(count), count - 1).T * (2 / count)
    matrix[0] /= 2
    return np.asarray(matrix)


def _hyperbola(contour: Contour) -> tuple[ComplexArray, ComplexArray]:
    """Return nodes s and weights, (node,) each, of an inverse Laplace transform along a hyperbola.

    The step response is S(t) = Re sum of weight exp(s t) U(s). Times are in units of the begin t0 of a panel, and s in
    units of 1/t0: one hyperbola serves times 1 to 4. Nodes lie only above the real axis; the weights include the
    complex conjugate half below it.
    """
    step = contour.span / contour.nodes
    # Midpoint rule in x.
    x = (np.arange(contour.nodes) + 0.5) * step
    s = contour.height * (1 + np.sin(1j * x - contour.alpha))
    # The weight is (ds/dx) dx / (pi j). Division by s, the transform of a step, gives the step response.
    return s, step / np.pi * contour.height * np.cos(1j * x - contour.alpha) / s


def _chebyshev_sum(coefficient: FloatArray, panel_index: Int64Array, position: FloatArray) -> FloatArray:
    """Return the value of a Chebyshev series for each time, (*time, response): that of the panel the time is in.

    ``coefficient`` (degree, panel, response). ``panel_index`` (*time,): panel of each time. ``position`` (*time, 1):
    position of the time in its panel, -1 to 1.
    """
    # Clenshaw's recurrence b_n = c_n + 2 x b_n+1 - b_n+2, degree by degree: numpy's chebval would need all coefficients
    # of all times, (degree, *time, response), at once.
    one_above, two_above, doubled = np.zeros_like(position), np.zeros_like(position), 2 * position
    for degree_coefficient in coefficient[:0:-1]:
        one_above, two_above = degree_coefficient[panel_index] + doubled * one_above - two_above, one_above
    return np.asarray(coefficient[0][panel_index] + position * one_above - two_above)
