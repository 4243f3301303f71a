"""Codes to volts to gated spectra.

echoes.py          the echoes in a range gate; displacement and velocity of each pulse
conditioning.py    codes -> volts; pulses with deviating energy are flagged
band.py            spectra in the band of the pulse
gate_tracking.py   a gate that follows large motion
"""
