"""Stored runs: open, estimate, process again, sweep, import, export and map; the functions of the public API.

arguments.py        types of the arguments of public functions
estimation.py       stored records -> estimates of every shot and of every gate over depth
result_warnings.py  warnings of a result, conditions of its shots
reprocessing.py     scene and plan at several values of the processing settings
run.py              an open run file: ``open_run(path) -> Run``
checked_scene.py    predictions for a scene before it is measured
echoes.py           gated echoes of any program as records in memory, estimated like those of a stored run; codes
importing.py        a recording of another program -> run file
exporting.py        a run -> file of zea, USTB or MATLAB
mapping.py          a recording of many lines -> map of its motion
settings_files.py   schemas of scene, bench and simulation; files with every key
api.py              ``measure``, ``estimate``, ``fit_moduli`` and the other functions offered by ``hpe_rig``
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
