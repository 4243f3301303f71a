"""Transducer: pressure of its aperture around the focus, echo response for tracking, and force of the push.

    diameter, focal length, apodisation   the settings               `sim_backend.settings.Transducer`
    P(r, z)                               Rayleigh integral          radiation.py
    P(r, z), measured                     a hydrophone's scan        hydrophone.py
    |P|²                                  push: sum of Gaussians     intensity.py
    P²                                    tracking: pulse-echo beam  pulse_echo.py
    dp/dz = beta/(2 rho c³) dp²/dt        one nonlinear step         burgers.py
    p_1 ... p_N (r, z)                    harmonics through layers   nonlinear.py
    force, p+, p-, heat over drive        the push as a table        push.py

Theory, and errors relative to closed forms: docs/explanation/transducer.md.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
