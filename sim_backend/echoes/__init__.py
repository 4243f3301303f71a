"""Echoes of moving point scatterers: r_k(t) = sum_n I_n p(t - tau_kn), eq. (10), to a tolerance.

    p(t)              eq. (9)                   pulse.py
    I_n, g_n          eq. (7), (8), (12)        scatterers.py
                      of an aperture            aperture.py
    tau_kn            eq. (10), (11)            delays.py
    the sum           eq. (10)                  exact_sums.py, series.py; choice.py estimates their run times
    one measurement                             engine.py
    many draws        for studies               many_draws.py

Cost and error of both evaluations: docs/explanation/echoes.md.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
