"""Command line: the commands, a few lines each, and their output.

Modules, from the typed command to its output::

    entry.py        ``main``: Ctrl-C while the program loads
    app.py          the program with all commands
    streams.py      standard streams without waiting
    options.py      arguments and options of several commands
    measuring.py    commands that measure: run, resume, queue, live, align
    stored_runs.py  commands on stored runs: process, report, compare, moduli, dispersion, verify, list
    recordings.py   commands on recordings of other programs: import, map
    scenes.py       commands on settings: check, scenes, new, schema, extensions
    benches.py      commands on benches: bench, commission, emulate
    bug_report.py   versions, scene, bench and log of a problem, without addresses and names
    studies.py      commands that study by simulation: accuracy, design, study
    watch.py        stop request, pause, log and live page of a run
    keys.py         keys pressed during a run
    queue.py        several runs, one after another
    bench.py        state of a bench, and its comparison with another
    identify.py     roles on the displays of the generators, serial numbers into the bench file
    off.py          outputs switched off and verified
    commission.py   questions and table of a commissioning
    listing.py      runs of a folder; extensions of other packages
    stored.py       damage, comparisons, moduli, dispersion and maps
    study.py        workers and progress of a study
    tables.py       a result as one sentence and tables
    terminal.py     width of the terminal; progress; logging
    console.py      exit codes, error messages, printed results

Each command imports its implementation when it is called, which keeps ``hpe-rig --help`` fast.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
