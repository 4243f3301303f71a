"""Transducer: the field of its aperture around the focus, and what tracking and force make of it.

    diameter, focal length, apodisation   `sim_backend.settings.Transducer`, the one description
    P(r, z)                               pressure of the bowl: O'Neil's Rayleigh integral   radiation.py
    P(r, z), measured                     a hydrophone's scan                                     hydrophone.py
    |P|^2                                 its intensity as a sum of Gaussians: the push      intensity.py
    P^2                                   what is heard of a scatterer: tracking             pulse_echo.py
    dp/dz = beta/(2 rho c^3) dp^2/dt      finite amplitude, one step of it                        burgers.py
    p_1 ... p_N (r, z)                    the push with its harmonics, through layers             nonlinear.py
    force, p+, p-, heat over drive        the push as a table                                     push.py

The theory, and its error against closed forms, is docs/explanation/transducer.md.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
