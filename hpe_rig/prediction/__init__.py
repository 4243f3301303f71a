"""Prediction of what a scene will measure, before it does: closed forms, small Monte Carlo sums and bounds.

    u_tracked / u_peak = prod_i 1 / sqrt(1 + T_i^2 / (2 E_i^2))        for Gaussian beams, eqs. (8) and (12)

    force of the bursts, Gaussian averaging, speckle                   theory.py
    the same in the medium's own field                                 beam_averaging.py
    bias and jitter of an estimator under given conditions             error_model.py
    the noise gain of the fit that is really made                      linear_fit.py
    what a scene expects of amplitude and SNR                          amplitude.py
    a scene's conditions, its forecast, what reaches a target          forecast.py
    the smallest amplitude that stands out                             detection.py
    harmonics that alias onto the wanted ones                          aliasing.py
    Cramer-Rao bounds                                                  bounds.py
    all of it as lines of text                                         text.py

Others use ``forecast_of(scene, shot)``, ``predicted_averaging``, ``detection_floor`` and what ends in ``_text``.
Theory: docs/theory/prediction.md.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
