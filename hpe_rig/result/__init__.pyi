from .estimates import (
    Averaging as Averaging,
    Estimate as Estimate,
    Result as Result,
    ShotResult as ShotResult,
    shot_warnings as shot_warnings,
)
from .rows import result_csv as result_csv
from .stages import Stages as Stages
