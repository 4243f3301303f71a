"""Command line: the commands, a few lines each, and what they print.

Files, from what is typed to what is shown::

    entry.py    ``main``: what Ctrl-C does before a command begins
    app.py      commands that plan, measure, process and look at a bench
    studies.py  commands that study scenes and estimators by simulation
    keys.py     keys pressed while a run goes on
    queue.py    several runs, one after another
    watch.py    stop request, pause, log and live page around a run
    bench.py    the report of a bench, and its comparison with another
    listing.py  the runs of a folder; what other packages bring
    stored.py   damage, comparisons, moduli and maps of stored runs and recordings
    study.py    workers, progress and closing table of a study
    tables.py   a result in one sentence and as tables
    terminal.py its width; progress; which log records it shows
    console.py  exit codes, error messages, progress, arguments that several commands share

Each command imports what it runs when it is called, which keeps ``hpe-rig --help`` as fast as typer.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
