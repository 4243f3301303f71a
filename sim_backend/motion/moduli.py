"""Complex shear modulus of the specimen's medium, a function of the complex frequency s = j w."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim_backend.settings import Specimen

Complexes = NDArray[np.complex128]


def shear_modulus(specimen: Specimen, s_per_s: Complexes) -> Complexes:
    """Return the modulus mu(s) in Pa, shape of ``s_per_s``; analytic off the negative real axis, so also in time.

    Voigt ``mu1 + s mu2``; Maxwell ``s mu1 mu2 / (mu1 + s mu2)``; Zener ``mu1`` beside a Maxwell branch of
    ``branch_modulus_pa`` and ``mu2``; power law ``mu1 (s / 2 pi f_r)^p``.
    """
    mu1, mu2 = specimen.shear_modulus_pa, specimen.shear_viscosity_pa_s
    match specimen.medium:
        case "voigt":
            return mu1 + s_per_s * mu2
        case "maxwell":
            return _branch(mu1, mu2, s_per_s)
        case "zener":
            return mu1 + _branch(specimen.branch_modulus_pa, mu2, s_per_s)
        case "power_law":
            turns = s_per_s / (2 * np.pi * specimen.reference_frequency_hz)
            return np.asarray(mu1 * turns**specimen.power)


def creeps_for_ever(specimen: Specimen) -> bool:
    """Return whether a constant force moves the medium without end: it has no static displacement."""
    return specimen.medium == "maxwell" or (specimen.medium == "power_law" and specimen.power > 0)


def _branch(modulus_pa: float, viscosity_pa_s: float, s_per_s: Complexes) -> Complexes:
    # Divided through by the modulus: neither a stiff spring nor a fast s overflows.
    return np.asarray(s_per_s * viscosity_pa_s / (1 + s_per_s * (viscosity_pa_s / modulus_pa)))
