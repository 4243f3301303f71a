"""Motion of the medium: tonebursts in, displacement at the focus and around it out; or a prescribed motion.

    D(t) = sum_i D_i sin(2 pi f_i t + phi_i)                      eq. (1), (13)   prescribed.py
    force ~ pressure^2, rectified and low-passed                  eq. (17), (18)  force.py
    U(s) = f0 V / mu(s) * mean over directions                    specimen.py: moduli, response at the focus, transient
    S(t) = 1/(2 pi j) int exp(s t) U(s)/s ds                      inverse_laplace.py: step response
    u(r, t) = sum_i shape_i(r) amplitude_i(t)                     field.py: displacement around the focus
    F = U (6 pi a mu (1 + l + l^2/9) + m s^2)                     sphere.py: a rigid sphere in the medium
    I_SPTA, I_SPPA limits                                         acoustic_dose.py

Theory: docs/explanation/medium.md. A prescribed motion loads only its own module.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
