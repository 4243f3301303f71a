"""Codes to volts to gated spectra.

gate.py            echoes of one pulse train in a range gate
conditioning.py    codes -> volts; statistics of each record; pulses with deviating energy
band.py            transmitted band: bins, taper, noise covariance and the projection onto the gate
spectrum.py        spectra in the band, and inner products of aligned spectra
"""
