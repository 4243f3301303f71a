"""VISA connections: a text line to an instrument over GPIB, RS-232, TCP socket, HiSLIP, VXI-11 or Prologix.

    connection           one connection, and the adapter that it may go through
    protocol_comsocket   what pyserial needs for a serial line over TCP on Windows

Others use ``VisaConnection``, and ``VisaInterface`` where an adapter comes first.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
