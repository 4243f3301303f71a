"""Design: the scene with the least jitter, bias or time within limits of dose, time and ``hpe-rig check``.

In the order of the flow: `command` (options) -> `variables` (what may change) -> `problem` (candidates and their cost,
by the closed forms of `model`) -> `search` -> `simulation_check` (the model against Monte Carlo) -> `page`. The command
line takes `Request` and `write_design`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
