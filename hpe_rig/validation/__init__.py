"""Validation: the twin and the estimators compared with exact references and with the statements of the paper.

`accuracy` measures error against run time; `paper` judges the paper's statements from the results of studies.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
