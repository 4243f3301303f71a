"""Settings of the twin: the section ``[simulation]`` of a scene.

quantities        types of the numbers, with bounds
presets           specimens and receive chains by name, with the source of every value
installed_media   media of other packages, by entry points
section           base of all tables
instruments       generators and digitizer, their clocks and faults
receiver          level and noise of the echoes, receive chain
specimen          medium, push, prescribed and background motion
simulation        beams and scatterers; checks between all tables

Each description states the source of the default: *paper* (Table I or Sec. III of the source paper), *manual*
(docs/explanation/instruments.md), *assumed* (no source; set it in the scene if it matters).
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
