"""Plan of a measurement: the scene turned into shots, every edge in absolute time; a function of scene and bench file.

    parts that the scene does not need               omitted.py
    shots, their trains, gates and records           shots.py
    gates over depth in the same records             gate_profile.py
    disturbance of tracking pulses by tonebursts     interference.py
    pulses and frequencies that a fit uses           selection.py
    time zero and sign of the stated phases          phase_reference.py
    conflicts and warnings, one module a subject     checks/
    the whole in words and as a drawing              timeline.py
    the timing of a shot as a picture                timing_figure.py

Other packages use ``make_plan``, ``check_plan``, ``refuse_conflicts``, and ``select`` for the pulses of a fit.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
