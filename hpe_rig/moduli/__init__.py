"""Moduli of the medium: its own shear field fitted to vibrations at one place or several, and the plane wave beside it.

    y_pn = g_p S_n exp(-j w_n tau) U(w_n, r_p, z_p; mu, A_p, B)

media.py (laws of the complex modulus), shear_field.py (U, with its derivatives), inversion.py (the fit, its covariance,
which laws the data exclude, what each datum brings), shear_speed.py (speed from the phase's fall with distance, and the
plane wave's moduli).

Others use ``fit_medium``, ``compare_media``, ``bound``, ``speed_of_runs`` and ``fit_voigt``; docs/theory/moduli.md.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
