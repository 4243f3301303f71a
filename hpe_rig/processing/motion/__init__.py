"""Displacement of each pulse from the gated echoes.

phase_shift.py     coherent, kasai and loupas: displacement from phase, with phase_shift_numba.py compiled
correlation.py     cross_correlation: displacement from the delay of maximum correlation
spectral_peak.py   cross_spectrum: velocity from the phase step at the spectral peak, eqs. (5) and (6), with
                   spectral_peak_numba.py compiled
"""
