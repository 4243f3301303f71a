from .moduli import phase_velocity_map as phase_velocity_map
from .result import Result as Result
from .runs import (
    CheckedScene as CheckedScene,
    Run as Run,
    check as check,
    dispersion as dispersion,
    estimate as estimate,
    estimate_motion as estimate_motion,
    export_run as export_run,
    fit_map_moduli as fit_map_moduli,
    fit_moduli as fit_moduli,
    import_records as import_records,
    map_motion as map_motion,
    measure as measure,
    open_bench as open_bench,
    open_run as open_run,
    sweep as sweep,
)
from .scene import Scene as Scene, load_scene as load_scene
from .store import read_covariance as read_covariance
from .study import run_study as run_study
