from .estimates import (
    Averaging as Averaging,
    Estimate as Estimate,
    Result as Result,
    ShotResult as ShotResult,
    shot_warnings as shot_warnings,
)
from .palette import PALETTE as PALETTE
from .rows import result_csv as result_csv
from .stages import Stages as Stages
from .tables import csv_text as csv_text, mappings as mappings, rich_table as rich_table, text_table as text_table
