"""AlazarTech digitizers over the vendor's ATSApi library: trigger in, records out.

    models         what each board accepts, one row a board
    limits         check of a capture against a board's limits; sizes of buffers
    api            the library's functions, signatures and constants
    return_codes   the library's return codes as errors
    board          one board's handle, every call checked
    page_buffer    page-aligned memory that a board writes into
    samples        memory layout -> codes, volts and trigger times
    captures       single-port and dual-port captures
    digitizer      the driver

``AlazarDigitizer(AlazarBoard(load_library()), clock)`` measures; ``model_named`` and ``mistakes`` need no board.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
