from .executor import cluster as cluster, processes as processes
from .map_figures import OURS as OURS, lateral_average as lateral_average
from .page import Part as Part, Table as Table, cell as cell, render as render, table as table, write as write
from .report import write_study_report as write_study_report
from .results import SUMMARY as SUMMARY, StudyResult as StudyResult
from .run import Watch as Watch, run_study as run_study
from .series import Curve as Curve, curves as curves, maps as maps, view as view
