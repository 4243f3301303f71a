"""Acquisition: a scene becomes a run file, and a run file a result.

    api.py            measure, estimate, open_bench: what ``hpe_rig`` offers to scripts
    setup.py          scene and bench file -> plan and what its checks found
    checked_scene.py  what can be said of a measurement before it is made
    run.py            plan -> a run file with every shot's records
    places.py         who moves the tracking transducer between shots
    sequencer.py      configure -> verify -> arm -> enable -> fire -> collect -> off, shot by shot
    recording.py      what the sequencer yields, into a run file that appears with its first record
    pause.py          a pause between two shots, from the terminal or the live page
    queue.py          several runs one after another under one lock
    provenance.py     who measures, when and where
    stop_request.py   a safe stop that another process asks for
    log.py            every step beside the run file
    run_file.py       a stored run, opened once: ``open_run(path) -> Run``, and its result, also over depth
    reprocessing.py   one estimated at every value of what is made of its records
    importing.py      a recording of another program becomes a run file
    mapping.py        one of many lines becomes a map of its motion
    settings_files.py the schema of scene, bench and simulation; a file with every key
    resumption.py     a stopped run continued: its complete shots kept, the others measured

A run file is opened with ``open_run`` alone: scene, bench, plan and checks come with it, validated. ``prepare`` and
``record_run`` are the two halves of a measurement, for callers that have to step in between.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
