"""Receiver: from the sum over scatterers to volts at the digitizer's input.

    echo gain, noise, toneburst leak              eq. (16)             front_end.py, always
    the noise, a block ahead                                           record_noise.py
    their random numbers, record by record                             streams.py
    trigger jitter, sample clock                                       timing.py
    notch, T/R switch, noise, band-pass, log      paper, Sec. III.B    chain.py, of elements.py

The last two only where the scene asks for them.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
