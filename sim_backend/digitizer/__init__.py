"""Digitizer as programs see it: ATSApi calls -> settings -> records taken -> words in memory or in posted buffers.

In the order of the flow:
    codes              the library's numbers
    boards             what tells the boards apart
    library            the function table
    settings           what each function changes
    state              one board between the calls
    board              settings and trigger edges -> records and AUX edges
    recording          the volts of a capture, made block by block as they are asked for
    auto_dma           posted buffers, and records as the board writes them
    capture_snapshot   one arming with everything that its records depend on

Others use ``AlazarLibrary`` in place of the vendor's, and ``Board`` with what it took.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
