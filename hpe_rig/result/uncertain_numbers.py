"""Complex values of a result as uncertain numbers of GTC, the GUM Tree Calculator (extra 'gtc').

Every variable of the covariance is an elementary uncertain number of value 0 and u = 1; a value is its phasor plus the
sum of influences times variables. GTC then propagates all covariances through any calculation. Variables of one shot
with the same finite degrees of freedom are an ensemble, as GTC calls errors from one residual.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hpe_rig.result.covariance import NO_VARIABLE, Covariance
from hpe_rig.result.tables import package_of_extra


def uncertain_numbers(covariance: Covariance) -> tuple[tuple[Any, ...], ...]:
    """Return the values of ``covariance`` as uncertain complex numbers of GTC, one tuple of frequencies for each row.

    Labels: source of the elementary numbers; "shot 1, 100 Hz" of the values. Raises ``ModuleNotFoundError`` that names
    the extra if GTC is not installed.
    """
    gtc = package_of_extra("GTC", "to_gtc", "gtc")
    variables = _elementary_numbers(covariance, gtc)
    table = []
    for row, shot in enumerate(covariance.shot.tolist()):
        numbers = []
        for index, frequency_hz in enumerate(covariance.frequency_hz[row].tolist()):
            if math.isnan(frequency_hz):
                continue
            number = complex(covariance.phasor_m[row, index])
            for column in np.flatnonzero(covariance.variable[row] != NO_VARIABLE).tolist():
                influence_m = complex(covariance.influence_m[row, index, column])
                number = number + influence_m * variables[int(covariance.variable[row, column])]
            # A result, as GTC calls it, can be stored in an archive.
            numbers.append(gtc.result(number, label=f"shot {shot}, {frequency_hz:g} Hz"))
        table.append(tuple(numbers))
    return tuple(table)


def _elementary_numbers(covariance: Covariance, gtc: Any) -> dict[int, Any]:
    """Return an elementary uncertain real number of value 0 and u = 1 for each variable, by the variable's number."""
    labels: dict[int, str] = {}
    ensembles: dict[tuple[int, float], list[int]] = {}
    for row, column in np.argwhere(covariance.variable != NO_VARIABLE).tolist():
        variable, degrees = int(covariance.variable[row, column]), float(covariance.degrees_of_freedom[row, column])
        if variable not in labels:
            labels[variable] = covariance.source[column]
            ensembles.setdefault((row, degrees) if math.isfinite(degrees) else (variable, degrees), []).append(variable)
    numbers = dict[int, Any]()
    for (_, degrees), ensemble in ensembles.items():
        if math.isinf(degrees):
            numbers |= {variable: gtc.ureal(0.0, 1.0, label=labels[variable]) for variable in ensemble}
            continue
        # Real and imaginary parts of complex numbers: GTC 1.5 has no degrees of freedom of a complex number that
        # depends on an ensemble of real ones (an assertion in its function willink_hall fails).
        pairs = list(zip(ensemble[::2], [*ensemble[1::2], None], strict=False))
        names = [labels[variable] for variable, _ in pairs]
        elementary = gtc.multiple_ucomplex([0j] * len(pairs), [1.0] * len(pairs), degrees, names)
        for (first, second), number in zip(pairs, elementary, strict=True):
            numbers |= {first: number.real} | ({} if second is None else {second: number.imag})
    return numbers
