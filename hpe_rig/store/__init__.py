"""Records and results on disk, in HDF5: written while a run goes on, readable at every moment, checked when read.

Files, in the order in which a run passes through them::

    format.py        names, versions and limits that writers and readers share; ``StoreError``; file names;
                     ``extra``: a missing optional package, named with the extra that brings it
    checksum.py      what vouches for every dataset, row and chunk
    layout.py        the empty run file: every group, dataset and attribute at its final size
    records.py       record blocks as they arrive -> the place of each record's pulse
    atomic.py        files that appear whole or not at all
    lock.py          one writer a file
    journal.py       what HDF5 writes -> the disk, step by step; what fails is seen, and never by HDF5
    writer.py        ``RunWriter``: creates the file; writes records, settings, ground truth and status
    validation.py    reading a file that anybody may have written: nothing is taken for granted
    reader.py        ``read_run``: the run file, shot by shot, when asked for
    result_file.py   ``write_result``: the result beside the run file
    listing.py       the runs of a folder, with title, result and notes
    verification.py  ``verify``: every checksum of a file compared

Other rooms write with ``RunWriter`` and ``write_result``, read with ``read_run`` and ``read_snapshots``, and catch
``StoreError``. The format itself, with its promises, is described in ``docs/reference/run-file.md`` and ``docs/reference/integrity.md``.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
