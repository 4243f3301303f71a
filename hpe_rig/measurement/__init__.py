"""Measurement: a scene becomes a run file.

    setup.py          scene and bench file -> plan and the findings of its checks
    run.py            setup -> run file with the records of every shot; ends if the first is at full scale
    between_shots.py  movement of the tracking transducer, wait until conditions are within limits
    sequencer.py      configure -> verify -> arm -> enable -> fire -> collect -> off, shot by shot
    background.py     storage and observers in separate threads while outputs are on
    awake.py          the computer does not sleep during a run
    recording.py      events of the sequencer -> run file
    requests.py       a safe stop, or a pause between two shots, requested by another process
    resumption.py     a stopped run continued with its missing shots
    queue.py          several runs one after another under one lock
    provenance.py     operator, time and place of a measurement
    log.py            the log file of a run
    cable_signals.py  a waveform for each instrument, and its time of arrival in records
    commissioning.py  every cable driven and looked for at the digitizer; results written into the bench file

``prepare`` and ``record_run`` are the two halves of a measurement.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
