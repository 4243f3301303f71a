"""Estimation of displacement amplitude and phase from gated echoes: pure functions, leading axes are realisations.

    codes -> volts, gate; pulses unlike the others are flagged              conditioning.py, echoes.py
    spectra in the band, aligned before the gate cuts them                  band.py
    a gate that follows large motion                                        gate_tracking.py
    D(t) = sum_i A_i sin(2 pi f_i t + phi_i) + background(t)       eq. (1)  model.py

    coherent           u_k = -c arg<mean of others, r_k> / (4 pi f_mean)    motion.py
                       of many trains compiled, where Numba is              motion_numba.py
    kasai, loupas      u_k = sum of -c arg<r_n, r_n+1> / (4 pi f)           motion.py
    cross_correlation  u_k = c/2 argmax_tau <mean of others(t - tau), r_k>  correlation.py
                       all harmonics at once, with a prior of media         prior.py, of ensemble.py
                       or A_i, phi_i, background: least squares             harmonic.py, or kalman_filter.py

    cross_spectrum     v_n = -c dtheta_n(f_c) / (4 pi f_c T_prf)            spectral_peak.py, eqs. (5) (6)
                       compiled, where Numba is                             spectral_peak_numba.py
                       D_n = v_n / w_i -> band-pass -> Hann -> Kalman, x 2  velocity_chain.py
                       then off with sinc(f_i / f_prf), T_prf / 2, 90 deg

    what a medium can do of tonebursts, as a prior of the fit               ensemble.py, prior.py
    how it moves beside the push                                            shear_field.py
    f(r, z) of a Gaussian beam, or of an aperture                           push_force.py
    many lines and depths at once, a pixel each                             motion_map.py
                       compiled, where Numba is loaded                      motion_map_numba.py
    what harmonics it does not resolve leave in a fit without prior         unresolved.py
    what distinguishes them, one row each                                   estimators.py
    what codes coarser than the noise leave                                 quantisation.py
    the uncertainty of each estimate, source by source                      budget.py
    a stored run, shot by shot, with its warnings                           shots.py, stationarity.py
    the motion of all burst periods over one another                        burst_period.py
    motion that nobody fitted                               residual_line.py
    the same from the twin's motion, at every instant                       ground_truth.py

Positive displacement is away from the transducer. Others use ``estimate`` on echoes (``EchoGate``), ``estimate_run`` on
a stored run, and ask ``spec_of(name)`` for an estimator's properties, never for its name. Theory:
docs/explanation/estimation.md.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
