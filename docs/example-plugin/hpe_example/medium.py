"""A spring parallel to a springpot: mu(s) = mu1 + mu_100 (s / 2 pi 100 Hz)^p, a Voigt medium for p = 1."""

import numpy as np

from hpe_rig.medium import Law, Parameter

REFERENCE_RAD_PER_S = 2 * np.pi * 100.0


def modulus(s, values):
    """Return mu(s), Pa, (..., frequency), and its derivatives by parameter (..., frequency, parameter)."""
    spring, pot, power = (values[..., i, None] for i in range(3))
    powers = (s / REFERENCE_RAD_PER_S) ** power
    modulus_pa = spring + pot * powers
    power_derivative = pot * powers * np.log(s / REFERENCE_RAD_PER_S)
    return modulus_pa, np.stack([np.ones_like(modulus_pa), powers, power_derivative], axis=-1)


FRACTIONAL_VOIGT = Law(
    "fractional_voigt",
    (
        Parameter.logarithmic("shear_modulus_pa", (100.0, 2e6), (0.7e3, 2e3, 6e3, 18e3, 60e3)),
        Parameter.logarithmic("springpot_modulus_pa", (1.0, 2e6), (200.0, 2e3, 20e3)),
        Parameter.linear("power", (0.05, 0.95), (0.3, 0.5, 0.8)),
    ),
    modulus,
    title="Fractional Voigt",
)
