"""Monte Carlo parameter studies on the twin: bias and jitter of the estimators, each with its standard error.

    definition.py      the study's TOML file
    kernels.py         linear kernels from echoes and noise to amplitude and phase
    measured_case.py   case by whole measurements
    cases.py           every point as a checked scene with its random numbers
    statistics.py      bias and jitter, eq. (14) and (15), with standard errors
    results.py         cases and tables on disk
    engine.py          cases of the gate alone: draws and noise -> statistics
    measured.py        cases by whole measurements -> statistics
    executor.py        processes of this machine, or a dask cluster
    run.py             `run_study`: compute the cases that are not completed
    series.py          views, curves and maps of the rows
    tables.py          closing tables for the terminal
    curve_figures.py   figures over one axis
    map_figures.py     maps over two axes
    report.py          the page

The command line runs studies, and validation reads their curves and maps.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
