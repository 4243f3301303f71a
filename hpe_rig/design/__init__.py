"""Design of a scene with the smallest jitter, bias or time within limits of dose, time and ``hpe-rig check``.

    variables.py          the numbers that may change, their bounds and steps
    model.py              SNR, amplitude, bias and jitter of a candidate, in closed form
    problem.py            candidates, their checks and costs
    search.py             differential evolution, then a pattern search
    simulation_check.py   the model against Monte Carlo
    comparison.py         the table before and after
    page.py               the page
    command.py            options -> search, table, page and new scene

The command line uses ``Request`` and ``write_design``.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
