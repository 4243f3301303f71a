"""Acoustics: bursts at the transducer in, volts at the digitizer's input out; motion, echoes and receiver combined.

tonebursts -> force -> displacement -> scatterers -> echoes -> volts       acoustics.py
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
