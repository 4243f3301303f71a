"""Displacement of each pulse from the gated echoes.

displacement.py    displacement and velocity of each pulse
phase_shift.py     coherent, kasai and loupas: displacement from phase; phase_shift_numba.py is the compiled form
correlation.py     cross_correlation: displacement from the delay of maximum correlation
spectral_peak.py   cross_spectrum: velocity from the phase step at the spectral peak, eqs. (5) and (6) of the paper;
                   spectral_peak_numba.py is the compiled form
gate_tracking.py   a gate that follows large motion
"""
