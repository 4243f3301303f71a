"""Recordings of other programs: a file becomes samples on named dimensions, with the settings of the recording.

In the order of the flow::

    settings.py      settings of a recording, from a sidecar file or options
    contents.py      content of a file as an importer reads it: arrays and stated settings; ``Importer``
    names.py         names of settings in the files of common programs
    arrays.py        NPY, NPZ, MATLAB, HDF5, WAV and raw samples
    scanners.py      layouts of scanners: UFF, zea, Verasonics; exported runs
    export_files.py  echoes of a run -> files of zea, USTB and MATLAB
    coordinates.py   times and indices in a table of echoes
    text.py          text: tables of numbers, exports of oscilloscopes
    matlab.py        MATLAB's version 5, read in a separate process
    alazar.py        AlazarTech's binary records
    oscilloscope.py  binary files of oscilloscopes, by RigolWFM
    importers.py     the importer of a file, also of other packages
    series.py        several files as one recording
    statements.py    settings from options, sidecar, file and scene, and the inferred ones
    axes.py          array of the samples, names of its axes; selected lines, or their mean
    carrier.py       echoes against the carrier; band-pass sampling; I and Q -> samples around the carrier
    motion.py        displacement and velocity instead of echoes
    recording.py     contents and settings -> samples (line, shot, pulse, sample)

``read_recording`` is the entry point. ``hpe_rig.runs`` writes a run file of its result.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
