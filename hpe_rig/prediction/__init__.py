"""Prediction of a measurement from its scene: expected amplitude, noise, bias, aliasing and detection floor.

    scene_physics.py    medium, push, beams and tracking gate that a scene states; force spectrum, eq. (18) of the paper
    conditions.py       expected amplitude and SNR; quantities that bias and jitter depend on
    speckle.py          random draws of scatterers and their echoes
    peak_noise.py       noise of an estimator that reads the peak of a cross-spectrum
    error_model.py      bias and jitter of an estimator: s = m sqrt(2 v / N)
    speckle_spread.py   standard deviations over speckle
    beam_averaging.py   tracked over peak displacement at every frequency
    linear_fit.py       noise gain of the later fit; change of the wanted harmonics by unresolved ones
    forecast.py         forecast of every estimator; settings that reach a target
    detection.py        smallest amplitude that exceeds the noise
    bounds.py           Cramer-Rao bound from a scene's own echoes
    time_base.py        phase uncertainty from the clocks
    output_text.py      acoustic output, dose and calibration as text
    text.py             forecasts as text

Callers use ``predicted_averaging``, ``detection_floor``, ``predict`` and the functions ending in ``_text``. Theory:
docs/explanation/prediction.md.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
