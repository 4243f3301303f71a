"""Validation: the twin and the estimators against exact references, and against the statements of the paper.

`accuracy` measures error against run time, `paper` repeats the paper's figures and judges its statements. The command
line writes their tables and pages; scripts take the experiments and the estimators' cases.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
