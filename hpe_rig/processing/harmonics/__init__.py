"""Displacement to amplitude and phase of each harmonic.

model.py                D(t) = sum_i A_i sin(2 pi f_i t + phi_i) + background(t), eq. (1)
harmonic_fit.py         the fit and its covariance; least squares
kalman_filter.py        the same by a Kalman filter
velocity_chain.py       velocity to harmonics as in the paper: band-pass, Hann window, Kalman filter
medium_prior.py         all harmonics at once, with a prior of media
aliasing_error.py       aliasing error of a fit without a medium prior
stationarity.py         drift of the amplitude between the halves of a record
residual_line.py        spectral lines in the residual
quantisation.py         error by the rounding of codes
"""
