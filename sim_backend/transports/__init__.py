"""Servers that offer the simulated generators to any VISA program, on loopback alone.

loopback   one instrument behind a lock; a listener on this machine
lines      raw TCP socket and RS-232
hislip     HiSLIP
vxi11      a VXI-11 gateway
prologix   a Prologix adapter
emulator   all generators of a bench over one of these
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
