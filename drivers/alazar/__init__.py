"""AlazarTech digitizer over the vendor's ATSApi: trigger in, records out.

In the order of the flow:
    models         what each board accepts, and how its codes are made
    limits         what a board cannot do of a capture, and sizes of records and buffers
    api            the library's functions, signatures and constants
    return_codes   the library's return codes, and how one becomes an error
    board          one board's handle; every call checked
    page_buffer    page-aligned memory that a board writes into
    captures       the two ways to capture
    samples        from memory layout to codes, volts and trigger times
    digitizer      the driver

Others use ``AlazarDigitizer`` and ``load_library`` to measure, ``model_named`` and ``mistakes`` to ask what a board can
do.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
