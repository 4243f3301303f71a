"""Importers by name: ours, and those that other packages bring."""

from __future__ import annotations

import difflib
from pathlib import Path

from hpe_rig.extensions import IMPORTERS, ExtensionError, installed, load, origin
from hpe_rig.recordings import alazar, arrays
from hpe_rig.recordings.contents import Contents, Importer
from hpe_rig.recordings.settings import RecordingSettings

HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
OURS: dict[str, Importer] = {
    "npy": arrays.Npy(),
    "npz": arrays.Npz(),
    "mat": arrays.Matlab(),
    "hdf5": arrays.Hdf5(),
    "csv": arrays.Csv(),
    "raw": arrays.Raw(),
    "alazar": alazar.Alazar(),
}


def importer_names() -> tuple[str, ...]:
    """Return the names of all importers, ours first."""
    return (*OURS, *(name for name in installed(IMPORTERS) if name not in OURS))


def read_contents(path: Path, settings: RecordingSettings) -> tuple[str, Contents]:
    """Return the format of ``path`` and its contents; raise ``ValueError`` or ``OSError`` where it cannot be read."""
    name = settings.format or _by_file(path, settings)
    if name in OURS:
        return name, OURS[name].read(path, settings)
    if name not in importer_names():
        close = difflib.get_close_matches(name, importer_names(), n=1)
        raise ValueError(
            f"format {name!r} is not known: {f'did you mean {close[0]}? ' if close else ''}"
            f"one of {', '.join(importer_names())}"
        )
    importer = foreign_importer(name)
    try:
        found = importer.read(path, settings)
    except (OSError, MemoryError):
        raise
    except ValueError as error:
        raise ValueError(f"importer {origin(IMPORTERS, name)}: {error}") from error
    except Exception as error:
        why = f"{type(error).__name__}: {error}"
        raise ExtensionError(f"importer {origin(IMPORTERS, name)} failed ({why}): report it to its authors") from error
    if not isinstance(found, Contents):
        raise ExtensionError(
            f"importer {origin(IMPORTERS, name)} returned {type(found).__name__} instead of Contents: report it to its "
            "authors"
        )
    return name, found


def foreign_importer(name: str) -> Importer:
    """Return the importer of another package; raise ``ExtensionError`` where it does not load or is none."""
    found = load(IMPORTERS, name)
    importer = found() if isinstance(found, type) else found
    if not isinstance(importer, Importer):
        raise ExtensionError(f"importer {origin(IMPORTERS, name)} has no suffixes or no read(path, settings)")
    return importer


def _by_file(path: Path, settings: RecordingSettings) -> str:
    """Return the format by what was said of the file, its ending or its first bytes."""
    if settings.board is not None:
        return "alazar"
    if settings.dtype is not None:
        return "raw"
    ending = path.suffix.lower()
    for name, importer in OURS.items():
        if ending in importer.suffixes:
            return name
    for name in importer_names():
        if name not in OURS and ending in foreign_importer(name).suffixes:
            return name
    with path.open("rb") as file:
        start = file.read(8)
    if start == HDF5_MAGIC:
        return "hdf5"
    if start[:6] == b"\x93NUMPY":
        return "npy"
    raise ValueError(
        f"the ending {ending or 'of a file without one'} tells no format: format = one of "
        f"{', '.join(importer_names())}, and for raw values dtype and shape"
    )
