"""Receiver: from the sum over scatterers to volts at the digitizer's input.

    echo gain, noise, toneburst leak              eq. (16)             front_end.py
    random numbers of each record                                      streams.py
    trigger jitter, sample clock                                       timing.py
    notch, T/R switch, noise, band-pass, log      paper, Sec. III.B    chain.py, elements.py
    timing and chain around ideal acoustics                            reception.py

Timing errors and the receive chain are optional parts of a scene.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
