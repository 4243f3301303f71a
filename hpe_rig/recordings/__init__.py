"""Recordings that another program made: a file becomes samples on named axes, with what is known of them.

In the order of the flow::

    settings.py      what a sidecar file or an option may say of a recording
    contents.py      what an importer finds in a file: arrays and statements; ``Importer``
    arrays.py        NPY, NPZ, MATLAB, HDF5, CSV and raw samples
    matlab.py        MATLAB's version 5, read by a program of its own
    alazar.py        AlazarTech's binary records
    importers.py     which importer reads a file; those of other packages too
    statements.py    who says what of a recording, and what is inferred
    recording.py     contents and settings -> samples (line, shot, pulse, sample), every inference said
    lines.py         lines chosen, or their mean
    baseband.py      I and Q -> samples around the carrier

``read_recording`` is what others use. ``acquire`` makes a run file of it.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
