"""Option ``--log-level``: which records of the packages' loggers reach standard error.

Each package has one logger of its name: ``hpe_rig`` (steps of a run), ``drivers`` (every message to an instrument),
``sim_backend`` (what the twin ignores). `hpe-rig run --verbose` writes a log beside the run file besides.
"""

from __future__ import annotations

import logging
from enum import StrEnum

OWN = ("hpe_rig", "drivers", "sim_backend")


class LogLevel(StrEnum):
    """Levels of Python's ``logging``, by the names that are typed."""

    DEBUG = "debug"
    INFO = "info"
    WARNING = "warning"
    ERROR = "error"


def start_logging(level: LogLevel) -> None:
    """Let records of at least ``level`` reach standard error; those of other packages from warnings on."""
    chosen = logging.getLevelNamesMapping()[level.upper()]
    logging.basicConfig(format="%(asctime)s %(levelname)s %(name)s: %(message)s", level=max(chosen, logging.WARNING))
    for name in OWN:
        logging.getLogger(name).setLevel(chosen)
