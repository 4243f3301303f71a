from .api import (
    dispersion as dispersion,
    estimate as estimate,
    estimate_motion as estimate_motion,
    fit_moduli as fit_moduli,
    measure as measure,
    open_bench as open_bench,
    sweep as sweep,
)
from .checked_scene import CheckedScene as CheckedScene, check as check
from .estimation import chosen_estimator as chosen_estimator
from .exporting import export_run as export_run
from .importing import import_recording as import_recording, import_records as import_records
from .mapping import (
    fit_map_moduli as fit_map_moduli,
    map_motion as map_motion,
    map_recording as map_recording,
)
from .run import (
    Run as Run,
    estimate_points as estimate_points,
    open_run as open_run,
    points_over as points_over,
    process as process,
)
from .settings_files import full_text as full_text, json_schema as json_schema, settings_tables as settings_tables
