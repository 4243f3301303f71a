"""Transducer: the field of its aperture around the focus, and what tracking and force make of it.

    diameter, focal length, apodisation   `sim_backend.settings.Transducer`, the one description
    P(r, z)                               pressure of the bowl: O'Neil's Rayleigh integral   radiation.py
    |P|^2                                 its intensity as a sum of Gaussians: the push      intensity.py
    P^2                                   what is heard of a scatterer: tracking             pulse_echo.py

The theory, and its error against closed forms, is docs/theory/transducer.md.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
