"""Displacement to amplitude and phase of each harmonic.

model.py             matrix of sinusoids and background, paper eq. (1); which frequencies the pulses resolve
harmonic_fit.py      amplitude, phase and covariance from the states; least squares
kalman_filter.py     the same model by a Kalman filter, with a test of its innovations
velocity_chain.py    velocity to harmonics as in the paper: band-pass, Hann window, Kalman filter
medium_prior.py      prior: states of all harmonics that media can have under tonebursts
projected_prior.py   the prior at the pulses of a train
prior_evidence.py    scale of the motion, noise and probability of each medium
medium_fit.py        fit with the prior, closed form and Kalman filter; posterior of the medium
rate_error.py        rate error of the motion's clock, one more unknown of the fit
aliasing_error.py    aliasing error of a fit without a prior
quantisation.py      error from rounding to the digitizer's codes
drift.py             change of the motion within the train: test, estimate, removal
fit_checks.py        spectral line in the residual
"""
