"""Acoustics: bursts at the transducer in, volts at the digitizer's input out.

    tonebursts -> force -> displacement -> scatterers -> echoes -> volts       acoustics.py
    the same with trigger jitter, receive chain and sample clock around it     reception.py

What ties motion, echoes and receiver together; a part that the settings leave out is neither loaded nor drawn.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
