"""Moduli of the medium: its own shear field fitted to vibrations at one place or several, and the plane wave beside it.

    y_pn = g_p S_n exp(-j w_n tau) U(w_n, r_p, z_p; mu, A_p, B)

places.py (vibrations of stored runs, place by place), media.py (laws of the complex modulus), vibration_model.py (the
model, and what is not known of push and places), inversion.py (the fit, its covariance, which laws the data exclude,
what each datum brings), outcome.py (all laws, as text and JSON), figure.py, forecast.py (how well a scene will tell the
moduli), shear_speed.py (speed from the phase's fall with distance, and the plane wave's moduli). U is
``hpe_rig.processing.shear_motion``.

Others use ``moduli_of`` on stored runs, ``moduli_forecast`` on scenes, ``fit_medium`` and ``bound`` on vibrations;
docs/theory/moduli.md.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
