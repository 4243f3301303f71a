from .executor import (
    NO_TLS as NO_TLS,
    TlsFiles as TlsFiles,
    cluster as cluster,
    processes as processes,
    untrusted_network as untrusted_network,
)
from .map_figures import OURS as OURS, lateral_average as lateral_average
from .measured_case import one_shot as one_shot
from .page import PageTable as PageTable, Part as Part, cell as cell, render as render, table as table
from .report import write_study_report as write_study_report
from .results import SUMMARY as SUMMARY, StudyResult as StudyResult, write_whole as write_whole
from .run import OnProgress as OnProgress, run_study as run_study
from .series import (
    Curve as Curve,
    View as View,
    curves as curves,
    error_figures as error_figures,
    maps as maps,
    refused_words as refused_words,
    spans as spans,
    view as view,
    with_error as with_error,
)
from .statistics import Errors as Errors, errors as errors
