"""Importers by name: built-in ones, and those of other packages."""

from __future__ import annotations

import difflib
from collections.abc import Callable
from pathlib import Path

from hpe_rig.extensions import IMPORTERS, TIMEOUT_S, VALUES_PER_S, ExtensionError, call, installed, load, origin
from hpe_rig.recordings import alazar, arrays, oscilloscope, text
from hpe_rig.recordings.contents import Contents, Importer
from hpe_rig.recordings.settings import RecordingSettings

HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
BUILT_IN: dict[str, tuple[tuple[str, ...], Callable[[Path, RecordingSettings], Contents]]] = {
    "npy": ((".npy",), arrays.read_numpy),
    "npz": ((".npz",), arrays.read_numpy),
    "mat": ((".mat",), arrays.read_matlab),
    "hdf5": ((".h5", ".hdf5", ".hdf", ".uff"), arrays.read_hdf5),
    "csv": ((".csv", ".txt", ".tsv", ".asc"), text.read_text),
    "wav": ((".wav",), arrays.read_wav),
    "oscilloscope": ((".trc", ".wfm", ".isf"), oscilloscope.read_oscilloscope),
    "raw": ((".raw", ".bin", ".dat", ".i16", ".f32", ".rf"), arrays.read_raw),
    "alazar": ((".alz", ".atb"), alazar.read_alazar),
}
"""Formats by name: lower-case suffixes and reader of each. A reader raises as ``Importer.read``."""


def importer_names() -> tuple[str, ...]:
    """Return the names of all importers, built-in ones first."""
    return (*BUILT_IN, *(name for name in installed(IMPORTERS) if name not in BUILT_IN))


def read_contents(path: Path, settings: RecordingSettings) -> tuple[str, Contents]:
    """Return the format of ``path`` and its content; raise ``ValueError`` or ``OSError`` for an unreadable file."""
    name = settings.format or _infer_format(path, settings)
    if name in BUILT_IN:
        return name, BUILT_IN[name][1](path, settings)
    if name not in importer_names():
        close = difflib.get_close_matches(name, importer_names(), n=1)
        raise ValueError(
            f"format {name!r} is not known: {f'did you mean {close[0]}? ' if close else ''}"
            f"one of {', '.join(importer_names())}"
        )
    importer, source = foreign_importer(name), f"importer {origin(IMPORTERS, name)}"
    timeout_s = TIMEOUT_S + path.stat().st_size / VALUES_PER_S
    try:
        contents = call(source, lambda: importer.read(path, settings), timeout_s, (OSError, ValueError))
    except ExtensionError as error:
        raise ExtensionError(str(error).replace(". Try: ", ": ")) from error
    except ValueError as error:
        raise ValueError(f"{source}: {error}") from error
    if not isinstance(contents, Contents):
        raise ExtensionError(
            f"importer {origin(IMPORTERS, name)} returned {type(contents).__name__} instead of Contents: "
            "report it to its authors"
        )
    return name, contents


def foreign_importer(name: str) -> Importer:
    """Return the importer of another package; raise ``ExtensionError`` if it does not load or is no importer."""
    loaded = load(IMPORTERS, name)
    importer = call(f"importer {origin(IMPORTERS, name)}", loaded) if isinstance(loaded, type) else loaded
    if not isinstance(importer, Importer):
        raise ExtensionError(f"importer {origin(IMPORTERS, name)} has no suffixes or no read(path, settings)")
    return importer


def _infer_format(path: Path, settings: RecordingSettings) -> str:
    """Return the format from the settings, the suffix of the file or its first bytes."""
    if settings.board is not None:
        return "alazar"
    if settings.dtype is not None:
        return "raw"
    suffix = path.suffix.lower()
    if suffix == ".bin" and oscilloscope.is_oscilloscope_file(path):
        return "oscilloscope"
    for name, (suffixes, _) in BUILT_IN.items():
        if suffix in suffixes:
            return name
    for name in importer_names():
        if name not in BUILT_IN and suffix in foreign_importer(name).suffixes:
            return name
    with path.open("rb") as file:
        start = file.read(8)
    if start == HDF5_MAGIC:
        return "hdf5"
    if start[:6] == b"\x93NUMPY":
        return "npy"
    raise ValueError(
        f"{f'the suffix {suffix}' if suffix else 'a file without suffix'} implies no format: format = one of "
        f"{', '.join(importer_names())}, and for raw values dtype and shape"
    )
