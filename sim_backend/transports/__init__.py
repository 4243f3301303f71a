"""Transports that offer the simulated generators to any VISA program, on loopback alone.

    loopback   one message at a time to an instrument; a listener on this machine
    lines      raw TCP socket and RS-232
    hislip     HiSLIP
    vxi11      a VXI-11 gateway
    prologix   a Prologix adapter
    emulator   all of a bench's generators over one of these

Others use ``Emulator``.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
