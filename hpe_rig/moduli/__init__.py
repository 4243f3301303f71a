"""Moduli of the medium from the phases of several runs: a speed from the phase's fall with distance, a Voigt fit to it.

    c_s(w) = w |dr / dphi|,    mu* = mu1 + j w mu2,    c_s = w / Re(w sqrt(rho / mu*))    shear_speed.py

Others use ``speed_of_runs`` and ``fit_voigt``.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
