"""Text connections to instruments by VISA resource name.

    connection   one connection to one instrument, whatever its resource name
    resources    GPIB, USB, RS-232, HiSLIP and VXI-11, by pyvisa
    rs232        settings of RS-232 lines, and pacing to the instrument's input buffer
    sockets      raw TCP sockets, by the standard library
    prologix     instruments behind a Prologix GPIB adapter
    failures     reasons why a connection fails, in words
    bounded      calls of libraries, limited in time

Other packages use ``VisaConnection``, ``PrologixAdapter``, ``SerialSettings``, ``NoVisaError``, ``OpenError`` and
``within``.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
