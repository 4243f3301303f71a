"""Echoes of moving point scatterers: r_k(t) = sum_n I_n p(t - tau_kn), eq. (10), to a tolerance.

    p(t)            eq. (9) and its like       pulse.py
    I_n, g_n        eq. (7), (8), (12)         scatterers.py
                    of a real beam             colouring.py
    tau_kn          eq. (10), (11)             delays.py
    the sum         eq. (10)                   engine.py, which runs what choice.py finds cheapest:
                                               exact_sums.py, combined.py, nodes.py, series.py
    many draws      for studies                many_draws.py, by series.py or, compiled, series_numba.py

docs/theory/echoes.md says what each evaluation costs, how far it errs and where it is the cheapest.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
