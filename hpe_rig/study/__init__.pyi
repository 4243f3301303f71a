from .executor import (
    TlsFiles as TlsFiles,
    cluster as cluster,
    processes as processes,
    untrusted_network as untrusted_network,
)
from .map_figures import PAPER_WIDTH_RATIO as PAPER_WIDTH_RATIO, lateral_average as lateral_average
from .measured_case import one_shot as one_shot
from .report import write_study_report as write_study_report
from .results import StudyResult as StudyResult
from .run import run_study as run_study
from .series import (
    Curve as Curve,
    View as View,
    curves as curves,
    maps as maps,
    paper_view as paper_view,
    with_error as with_error,
)
from .statistics import Errors as Errors, errors as errors
from .tables import error_table as error_table, run_time_table as run_time_table
