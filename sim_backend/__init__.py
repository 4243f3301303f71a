"""The digital twin: programmed registers -> edges -> bursts -> force -> motion -> echoes -> codes.

It stands in at the wire: SCPI text for the generators, the ATSApi function table for the digitizer.
"""
