"""Settings of the twin: the section ``[simulation]`` of a scene.

quantities        types of the numbers, with bounds
presets           specimens and receive chains by name, with the source of every value
installed_media   media of other packages, by entry points
simulation        the tables
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
