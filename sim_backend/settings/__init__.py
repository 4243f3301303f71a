"""Settings of the twin: what ``[simulation]`` may say, and the specimens and receive chains it may name.

simulation.py (the tables), quantities.py (types of their numbers, with bounds),
presets.py (specimens and chains by name, with the source of every value), installed_media.py (media of other
packages, by entry points).
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
