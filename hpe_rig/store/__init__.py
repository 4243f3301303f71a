"""Run files and result files: a log during a run, HDF5 afterwards; readable at any moment, verified when read.

    format.py        names, versions, limits and file names; ``StoreError``; ``extra``: a missing optional package
    foreign_hdf5.py  bounded reading of HDF5 files of unknown origin
    datasets.py      the datasets of a run file: type, axes, unit and kind of checksum
    damage.py        damage of a file, in words
    checksum.py      the checksum of every dataset, row and chunk
    layout.py        the empty run file: every group, dataset and attribute at its final size
    placement.py     trigger times -> the pulse of each record
    records.py       blocks of records -> codes by pulse
    atomic.py        atomic writing of files
    task.py          a task on a disk that may not respond
    json_checksum.py JSON files with a checksum
    lock.py          one writer for each file
    log.py           the log of a run in progress: frames with checksums, appended
    validation.py    validation of a file of unknown origin
    assembly.py      log -> run file in HDF5
    source.py        ``open_checked``: opens a run file or a log
    rows.py          rows of datasets, compared with their checksums
    codes.py         codes of a shot's records, chunk by chunk
    stored_records.py  records and true displacement of each shot, on demand
    reader.py        ``read_run``: the content of a run
    writer.py        ``RunWriter``: appends records, settings, ground truth and status to the log
    marks.py         verdicts on shots after the run, in a file of their own
    result_file.py   ``write_result``: the result file
    map_file.py      ``write_map``: a motion map as NetCDF
    listing.py       the runs of a folder, with title, result and notes
    verification.py  ``verify``: compares every checksum of a file

The file format is described in ``docs/reference/run-file.md`` and ``docs/reference/integrity.md``.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
