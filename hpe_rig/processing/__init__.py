"""Displacement amplitude and phase from gated echoes: pure functions; leading axes are independent realisations.

    echo/              codes -> volts -> spectra in the band, over the gate
    motion/            displacement u_k of each pulse: coherent, kasai, loupas, cross_correlation, cross_spectrum
    harmonics/         D(t) = sum_i A_i sin(2 pi f_i t + phi_i) + background(t), eq. (1) of the paper
    maps/              motion of many lines and depths, one pixel per gate
    compilation.py     optional compilation of loops by Numba
    estimators.py      estimators by name: echoes -> displacement -> harmonics
    budget.py          uncertainty of each estimate, source by source
    error_influences.py  errors of a shot's complex values, source by source
    first_pulse.py     the tracking pulse of each record
    tracking_rate.py   rate of the pulses by the digitizer's clock
    toneburst_phases.py  rate of the tonebursts by the clock of the pulses, from the second input
    shot_tracking.py   echoes and displacement of a stored shot
    control.py         motion without tonebursts, and the uncertainty of its subtraction
    shot_controls.py   motion in the controls of a stored run
    shot_fitting.py    harmonic fit of a shot: options, prior, beam averaging
    time_base.py       rate error of the motion's clock by that of the pulses
    motion_model.py    fitted displacement of each pulse
    shot_warnings.py   warnings of a shot
    stated_motion.py   displacement and velocity of another program
    shots.py           estimates of every shot of a stored run
    burst_period.py    motion of all burst periods, superposed
    ground_truth.py    harmonics of the simulated motion

Positive displacement is away from the transducer. Other packages call ``estimate`` for echoes (``EchoGate``),
``estimate_run`` for a stored run, and ``spec_of(name)`` for the properties of an estimator. Theory:
docs/explanation/estimation.md.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
