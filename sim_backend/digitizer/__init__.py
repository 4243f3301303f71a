"""Simulated digitizer: ATSApi calls -> settings -> accepted triggers -> words in memory or in posted buffers.

codes              the library's numbers
boards             one row a board
library            the function table
settings           the changes that each function makes
state              one board between the calls
board              settings and trigger edges -> accepted triggers and AUX edges
capture_snapshot   one arming with everything that determines its records
recording          the volts of a capture, computed block by block
direct_input       the volts of outputs that lead to an input directly
auto_dma           posted buffers, and records in the board's format
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
