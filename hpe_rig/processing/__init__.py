"""From gated echoes to displacement amplitude and phase: pure functions, leading axes are independent realisations.

    codes -> volts -> gate                                             conditioning.py, echoes.py
    pulses that are unlike the others are flagged                      flags.py
    the motion of echoes that stand still is taken off                 reference.py
    a gate that follows large motion                                   following.py
    D(t) = sum_i A_i sin(2 pi f_i t + phi_i) + background(t)           eq. (1), model.py

    coherent           u_k = -c arg<mean of others, r_k> / (4 pi f_mean)       motion.py
    kasai, loupas      u_k = sum of -c arg<r_n, r_n+1> / (4 pi f)              motion.py
    cross_correlation  u_k = c/2 argmax_tau <mean of others(t - tau), r_k>     correlation.py
                       A_i, phi_i, background at once: least squares           harmonic.py, or kalman.py
    joint              A_i, phi_i that make all echoes one echo, delayed       joint.py

    cross_spectrum     v_n = -c dtheta_n(f_c) / (4 pi f_c T_prf)  eqs. (5) (6) motion.py
                       D_n = v_n / w_i -> band-pass -> Hann -> Kalman, x 2     velocity_chain.py
                       then off with sinc(f_i / f_prf), T_prf / 2, 90 degrees

Positive displacement is away from the transducer.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
