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

from __future__ import annotations

from hpe_rig.processing.correlation import cross_correlation
from hpe_rig.processing.echoes import EchoGate, Motion, Velocity, velocity_between_pulses
from hpe_rig.processing.estimators import ESTIMATORS, Estimator, Options, estimate, fit_motion, motion_of
from hpe_rig.processing.flags import unlike_pulses
from hpe_rig.processing.following import added, follow
from hpe_rig.processing.halves import Drift, drift_between_halves
from hpe_rig.processing.harmonic import HarmonicFit, Innovations, least_squares
from hpe_rig.processing.joint import joint
from hpe_rig.processing.kalman import kalman
from hpe_rig.processing.motion import coherent, cross_spectrum, kasai, loupas
from hpe_rig.processing.reference import relative_to
from hpe_rig.processing.velocity_chain import Steps, velocity_to_harmonics

__all__ = [
    "ESTIMATORS",
    "Drift",
    "EchoGate",
    "Estimator",
    "HarmonicFit",
    "Innovations",
    "Motion",
    "Options",
    "Steps",
    "Velocity",
    "added",
    "coherent",
    "cross_correlation",
    "cross_spectrum",
    "drift_between_halves",
    "estimate",
    "fit_motion",
    "follow",
    "joint",
    "kalman",
    "kasai",
    "least_squares",
    "loupas",
    "motion_of",
    "relative_to",
    "unlike_pulses",
    "velocity_between_pulses",
    "velocity_to_harmonics",
]
