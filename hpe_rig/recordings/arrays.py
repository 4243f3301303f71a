"""Importers of array files: NPY, NPZ, MATLAB, HDF5 and raw values."""

from __future__ import annotations

import math
import struct
import tempfile
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpe_rig.recordings.contents import Contents
from hpe_rig.recordings.matlab import PREFIX, TEMPORARY_REMEDY, matlab_to_npz
from hpe_rig.recordings.names import key_of, setting_of
from hpe_rig.recordings.scanners import scanner_contents
from hpe_rig.recordings.settings import Dimension, RecordingSettings
from hpe_rig.store import (
    InvalidContentError,
    bytes_in_memory,
    max_bytes_of,
    objects,
    refuse_elsewhere,
    refuse_expansion,
)

MIN_MAPPED_BYTES = 2**25
"""Size above which values stay in the file until they are used, so that long recordings need little memory."""
NUMPY_MAGIC = b"\x93NUMPY"
MIN_VECTOR = 8
"""Values of a vector that may be a record."""
MAX_STATED_ENTRIES = 1_000_000
"""Largest array that may be a stated setting, such as the times of the pulses."""

PLAIN_FILE = "an HDF5 or NPZ file without compression, with all values in it"
"""Remedy for a file that refers to other files or expands too much."""
LIST_KEYS = ("pulse_time_s", "line_position_m")


def read_numpy(path: Path, settings: RecordingSettings) -> Contents:
    """Return the array of an NPY file, or the arrays of an NPZ file."""
    try:
        # Opened here: NumPy would not close a file that is no archive.
        with path.open("rb") as file:
            if path.stat().st_size >= MIN_MAPPED_BYTES and file.read(6) == NUMPY_MAGIC:
                return contents({path.stem: np.lib.format.open_memmap(path, mode="r")})
            file.seek(0)
            loaded = np.load(file, allow_pickle=False)
            if isinstance(loaded, np.ndarray):
                return contents({path.stem: loaded})
            with loaded:
                # The archive states the size of each array, and NumPy reads no more.
                size = sum(entry.file_size for entry in loaded.zip.infolist())
                refuse_expansion(size, max_bytes_of(path), "its content")
                return contents({name: loaded[name] for name in loaded.files})
    except InvalidContentError as error:
        raise ValueError(f"{error}: {PLAIN_FILE}") from None
    except OSError:
        raise
    except Exception as error:
        # Damaged bytes may raise any exception, such as one of Python's tokenizer.
        kind, function = ("NPZ", "savez") if path.suffix.lower() == ".npz" else ("NPY", "save")
        if "Object arrays" in str(error) or "Python objects" in str(error):
            raise ValueError(
                "it holds Python objects, which may run programs when they are read: one array of numbers, such as "
                f"numpy.{function}({path.stem!r}, numpy.stack(records)) in the program that wrote it"
            ) from error
        raise ValueError(f"it is no whole {kind} file ({_first_line(error)}): an undamaged copy") from error


def read_matlab(path: Path, settings: RecordingSettings) -> Contents:
    """Return the variables of a MATLAB file and the fields of its structures."""
    import h5py

    if h5py.is_hdf5(path):
        # Version 7.3 is HDF5 with the axes in reverse order.
        return read_hdf5(path, settings, reverse=True)
    try:
        folder = tempfile.TemporaryDirectory()
    except OSError as error:
        why = error.strerror or error
        raise ValueError(f"no temporary file can be made for its numbers ({why}): {TEMPORARY_REMEDY}") from error
    with folder:
        converted = Path(folder.name) / "variables.npz"
        matlab_to_npz(path, converted, max_bytes_of(path))
        with np.load(converted) as loaded:
            values = {name.removeprefix(PREFIX): loaded[name] for name in loaded.files}
            return scanner_contents(values, settings.variable) or contents(values)


def read_hdf5(path: Path, settings: RecordingSettings, reverse: bool = False) -> Contents:
    """Return the datasets and attributes of an HDF5 file; if ``settings`` name a dataset, no other large one.

    ``reverse`` the order of axes. Complex numbers may have the notation of h5py or MATLAB.
    """
    import h5py

    hdf5 = _Hdf5Values(settings.variable, max_bytes_of(path), reverse)
    try:
        with h5py.File(path, "r") as file:
            hdf5.visit("", file)
            for name, item in objects(file):
                hdf5.visit(name, item)
    except InvalidContentError as error:
        raise ValueError(f"{error}: {PLAIN_FILE}") from None
    except (OSError, RuntimeError, KeyError) as error:
        raise ValueError(f"it is no readable HDF5 file ({_first_line(error)}): an undamaged copy") from error
    return scanner_contents(hdf5.values, settings.variable) or contents(hdf5.values)


@dataclass(slots=True)
class _Hdf5Values:
    """Numbers and arrays of an HDF5 file by their path; of large datasets ``variable`` alone, unless it is None."""

    variable: str | None
    max_bytes: int
    reverse: bool
    values: dict[str, NDArray[Any]] = field(default_factory=dict)
    bytes_read: int = 0

    def visit(self, name: str, item: Any) -> None:
        """Read attributes and numbers of the group or dataset ``item``."""
        import h5py

        if name.startswith("#"):
            # Elements of cells, which are read by their references.
            return
        for key in item.attrs:
            # Texts are no settings: one in a damaged file can trap the HDF5 library in an endless loop.
            if _is_numbers(item.attrs.get_id(key).dtype):
                self.values.setdefault(f"{name}.{key}" if name else key, np.asarray(item.attrs[key]))
        if isinstance(item, h5py.Group) and {"command", "argument"} <= item.keys():
            self.values.update(_commands(name, item, self._read))
        if isinstance(item, h5py.Dataset) and item.shape is not None:
            self._add_dataset(name, item)

    def _add_dataset(self, name: str, dataset: Any) -> None:
        import h5py

        if h5py.check_ref_dtype(dataset.dtype) is h5py.Reference:
            # A cell or a field of a MATLAB array of structures refers to its elements.
            elements = [dataset.file[reference] for reference in np.ravel(self._read(dataset)) if reference]
            self._add_elements(name, elements)
        elif _is_numbers(dataset.dtype):
            is_large = dataset.size > MAX_STATED_ENTRIES
            is_selected = self.variable is None or f"{name}/".startswith(f"{self.variable.strip('/')}/")
            if is_selected or not is_large:
                self.values[name] = _plain(self._read(dataset), self.reverse)

    def _add_elements(self, name: str, elements: list[Any]) -> None:
        """Add the ``elements`` of a cell as one array, if they are arrays of numbers of one shape."""
        import h5py

        if not all(isinstance(element, h5py.Dataset) and _is_numbers(element.dtype) for element in elements):
            return
        arrays = [_plain(self._read(element), self.reverse) for element in elements]
        if len({array.shape for array in arrays}) == 1:
            self.values[name] = arrays[0] if len(arrays) == 1 else np.stack(arrays)

    def _read(self, dataset: Any) -> Any:
        """Return the values of a dataset; raise ``InvalidContentError`` if all together expand to too many bytes."""
        refuse_elsewhere(dataset)
        self.bytes_read += bytes_in_memory(dataset)
        refuse_expansion(self.bytes_read, self.max_bytes, dataset.name)
        mapped = _mapped(dataset) if dataset.size * dataset.dtype.itemsize >= MIN_MAPPED_BYTES else None
        return dataset[()] if mapped is None else mapped


def _mapped(dataset: Any) -> NDArray[Any] | None:
    """Return the values of a ``dataset`` in its file; None if they are compressed or in chunks."""
    offset = dataset.id.get_offset()
    if offset is None or dataset.dtype.kind not in "iuf":
        return None
    values = np.memmap(dataset.file.filename, dataset.dtype, "r", offset, dataset.shape)
    # HDF5 counts from the end of a user block, which not every version includes in the offset.
    first_and_last = ((index,) * max(1, dataset.ndim - 1) for index in (0, -1))
    is_same = all(np.array_equal(values[row], dataset[row], equal_nan=True) for row in first_and_last)
    return values if is_same else None


def read_raw(path: Path, settings: RecordingSettings) -> Contents:
    """Return the values of a file of raw values in the stated shape."""
    if settings.dtype is None or settings.shape is None:
        absent = [name for name in ("dtype", "shape") if getattr(settings, name) is None]
        raise ValueError(
            f"a file of raw values needs {' and '.join(absent)}: a sidecar file "
            f'{path.name}.toml with dtype = "int16", shape = [60, 512], axes = "pulse,sample" and the rates'
        )
    dtype = np.dtype(settings.dtype).newbyteorder("<" if settings.byte_order == "little" else ">")
    size, expected = path.stat().st_size, math.prod(settings.shape) * dtype.itemsize + settings.header_bytes
    if size != expected:
        raise ValueError(
            f"it has {size} bytes, {settings.shape} values of {settings.dtype} and a header of "
            f"{settings.header_bytes} bytes take {expected}: the right shape, dtype or header_bytes"
        )
    if size >= MIN_MAPPED_BYTES:
        return contents({path.stem: np.memmap(path, dtype, "r", settings.header_bytes, settings.shape)})
    values = np.fromfile(path, dtype, offset=settings.header_bytes).reshape(settings.shape)
    return contents({path.stem: values.astype(dtype.newbyteorder("="), copy=False)})


def read_wav(path: Path, settings: RecordingSettings) -> Contents:
    """Return the samples of a WAV file, (sample,) or (sample, channel), and the rate in its header."""
    from scipy.io import wavfile

    try:
        with warnings.catch_warnings():
            # Chunks of notes hold no samples.
            warnings.simplefilter("ignore", wavfile.WavFileWarning)
            warnings.filterwarnings("error", "Reached EOF", wavfile.WavFileWarning)
            rate_hz, samples = wavfile.read(path)
    except (ValueError, EOFError, struct.error, wavfile.WavFileWarning, NameError, ArithmeticError) as error:
        # SciPy raises the last two for a damaged header.
        raise ValueError(f"it is no whole WAV file ({_first_line(error)}): an undamaged copy") from error
    axes: tuple[Dimension, ...] = ("sample", "line") if samples.ndim > 1 else ("sample",)
    return Contents({path.stem: samples}, {"sample_rate_hz": (float(rate_hz), "the header")}, axes=axes)


def contents(values: Mapping[str, NDArray[Any]]) -> Contents:
    """Return ``values`` divided into possible samples and stated settings: numbers and lists with a name in `NAMES`."""
    arrays, stated = dict[str, NDArray[Any]](), dict[str, tuple[Any, str]]()
    for name, value in values.items():
        if not _is_numbers(value.dtype):
            continue
        key = key_of(name)
        # MATLAB stores numbers and lists as matrices.
        squeezed = value.reshape(-1) if value.ndim and value.size == max(value.shape) else value
        if key in LIST_KEYS and squeezed.ndim == 1 and squeezed.size > 1:
            stated.setdefault(key, (tuple(map(float, np.real(squeezed).tolist())), name))
        elif key not in LIST_KEYS and value.size == 1:
            if setting := setting_of(name, float(np.real(value.reshape(-1)[0]))):
                stated.setdefault(setting[0], (setting[1], name))
        elif squeezed.size >= MIN_VECTOR:
            arrays[name] = value
    return Contents(arrays, stated)


def _is_numbers(dtype: np.dtype[Any]) -> bool:
    return dtype.kind in "iufc" or dtype.names in (("real", "imag"), ("r", "i"))


def _plain(values: Any, reverse: bool) -> NDArray[Any]:
    array = np.asarray(values)
    if array.dtype.names:
        real, imag = (array[name] for name in array.dtype.names)
        array = real + 1j * imag
    return array.T if reverse else array


def _commands(name: str, structures: Any, read: Callable[[Any], Any]) -> dict[str, NDArray[Any]]:
    """Return the numbers in ``argument`` of a MATLAB array of structures by the text in their ``command``."""
    import h5py

    columns = []
    for item in (structures["command"], structures["argument"]):
        is_list = isinstance(item, h5py.Dataset) and h5py.check_ref_dtype(item.dtype) is h5py.Reference
        columns.append([item.file[entry] if entry else None for entry in np.ravel(read(item))] if is_list else [item])
    arguments: dict[str, list[float]] = {}
    for command, argument in zip(*columns, strict=False):
        if not (isinstance(command, h5py.Dataset) and isinstance(argument, h5py.Dataset)):
            continue
        # MATLAB stores the codes of characters.
        if command.dtype == np.uint16 and argument.size == 1 and argument.dtype.kind in "iuf":
            text = "".join(map(chr, np.ravel(read(command))))
            arguments.setdefault(f"{name}.{text}", []).append(float(np.ravel(read(argument))[0]))
    return {text: np.array(numbers) for text, numbers in arguments.items()}


def _first_line(error: BaseException) -> str:
    return str(error).partition("\n")[0][:160] or type(error).__name__
