"""Plan of a measurement: the scene turned into shots, every edge in absolute time; a function of scene and bench file.

    what the scene does without                              omitted.py
    shots, their trains, gates and records                   shots.py
    gates over depth, of the same records                    gate_profile.py
    when a toneburst disturbs a tracking pulse               interference.py
    which pulses and frequencies a fit uses                  selection.py
    what speaks against it, one file a subject               checks/
    the whole in words and as a drawing                      timeline.py
    the timing of a shot as a picture                        timing_figure.py

Others use ``make_plan``, ``check_plan``, ``refuse_conflicts``, and ``select`` for the pulses and frequencies of a fit.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
