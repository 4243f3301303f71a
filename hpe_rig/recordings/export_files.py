"""Echoes of a run in the layouts of other programs: zea, UFF of USTB, and MATLAB (version 5).

Each shot is a frame and each tracking pulse a transmit, received by one channel. Values that a layout does not provide
for, such as the times of the pulses and the truth of a simulation, are in a group or in variables of their names.
`hpe_rig.recordings.scanners` reads the files again.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import h5py
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hpe_rig.arrays import FloatArray, Int16Array, Int64Array
from hpe_rig.store import MISSING

ExportFormat = Literal["zea", "uff", "mat"]
LABEL_GROUPS: Mapping[str, str] = {"zea": "custom", "uff": "hpe_rig"}
"""Groups of the values by name; the variables of a MATLAB file have no group."""
CODES = "echo_codes"
"""Name of the echoes in a MATLAB file."""
ZEA_VERSION, UFF_VERSION = "0.1.8", "v1.2.0"
"""Versions of the layouts, which their readers compare."""
LIBVER = ("earliest", "v110")
"""MATLAB reads HDF5 of these versions."""
BLOCK_SAMPLES = 1 << 20
"""Samples that are converted to volts at a time."""
SPHERICAL_WAVE = 1
"""Number of a focused wave in UFF."""


@dataclass(frozen=True, slots=True)
class Label:
    """Value of an exported file: number, array or text, its unit and its meaning."""

    value: ArrayLike | str
    unit: str
    meaning: str


@dataclass(frozen=True, slots=True)
class Echoes:
    """Echoes of a run and the values that describe them.

    ``shape``: (shot, pulse, sample). ``codes_of``: codes of a shot, counted from 0, (pulse, sample), ``MISSING`` where
    no record exists; volts = code * ``scale_v`` + ``offset_v``. ``pulse_time_s`` (shot, pulse). ``focus_m``: distance
    from the transducer. ``labels`` by name: all values, those of the fields above included.
    """

    title: str
    shape: tuple[int, int, int]
    codes_of: Callable[[int], Int16Array]
    scale_v: float
    offset_v: float
    sample_rate_hz: float
    carrier_hz: float
    sound_speed_m_per_s: float
    first_sample_s: float
    focus_m: float
    pulse_time_s: FloatArray
    labels: Mapping[str, Label]

    def volts(self, shot: int) -> Iterator[tuple[slice, NDArray[np.float32]]]:
        """Yield pulses of ``shot`` and their volts, (pulse, sample), block by block; NaN where no record exists."""
        codes = self.codes_of(shot)
        step = max(1, BLOCK_SAMPLES // codes.shape[1])
        for first in range(0, codes.shape[0], step):
            block = codes[first : first + step]
            volts = np.where(block == MISSING, np.nan, block * self.scale_v + self.offset_v)
            yield slice(first, first + len(block)), volts.astype(np.float32)


def export_image(echoes: Echoes, file_format: ExportFormat) -> tuple[bytes, Int64Array]:
    """Return the content of a file with the ``echoes``, and the number of missing records of each shot, (shot,)."""
    memory = io.BytesIO()
    if file_format == "mat":
        missing = _write_matlab(memory, echoes)
        return memory.getvalue(), missing
    # Written to memory first: a disk error inside the HDF5 library can crash the program.
    with h5py.File(memory, "w", libver=LIBVER) as file:
        missing = (_write_zea if file_format == "zea" else _write_uff)(file, echoes)
        for name, label in echoes.labels.items():
            path = f"{LABEL_GROUPS[file_format]}/{name}"
            file[path] = label.value
            file[path].attrs.update({"unit": label.unit, "description": label.meaning})
    return memory.getvalue(), missing


def _write_matlab(file: Any, echoes: Echoes) -> Int64Array:
    """Write codes (sample, pulse, shot) and all labels as variables, and a variable ``readme`` that describes them.

    Return the number of missing records of each shot, as the other two formats.
    """
    from scipy.io import savemat

    shots, pulses, samples = echoes.shape
    codes = np.empty((samples, pulses, shots), np.int16, order="F")
    for shot in range(shots):
        codes[:, :, shot] = echoes.codes_of(shot).T
    variables: dict[str, Any] = {CODES: codes}
    readme = [
        f"{CODES} (sample, pulse, shot): volts = {CODES} * scale_v + offset_v; {MISSING}: not recorded",
        *(f"{name} / {label.unit}: {label.meaning}" for name, label in echoes.labels.items()),
    ]
    for name, label in echoes.labels.items():
        # MATLAB counts the shots along the last axis.
        variables[name] = label.value if isinstance(label.value, str) else np.asarray(label.value).T
    savemat(file, {**variables, "readme": np.array(readme, np.object_)[:, None]}, oned_as="column")
    missing: Int64Array = np.count_nonzero(codes[0] == MISSING, axis=0)
    return missing


def _write_zea(file: h5py.File, echoes: Echoes) -> Int64Array:
    """Write the groups that zea requires: volts (frame, transmit, sample, element, component), scan and probe."""
    shots, pulses, samples = echoes.shape
    origin = "simulated" if echoes.labels["simulated"].value else "measured"
    file.attrs.update({"zea_version": ZEA_VERSION, "description": echoes.title, "us_machine": f"hpe_rig, {origin}"})
    data = file.create_dataset("tracks/track_0/data/raw_data", (shots, pulses, samples, 1, 1), "f4", chunks=True)
    missing = np.zeros(shots, np.int64)
    for shot in range(shots):
        for pulses_of_block, volts in echoes.volts(shot):
            data[shot, pulses_of_block, :, 0, 0] = volts
            missing[shot] += np.isnan(volts[:, 0]).sum()
    intervals_s = np.diff(echoes.pulse_time_s, append=2 * echoes.pulse_time_s[:, -1:] - echoes.pulse_time_s[:, -2:-1])
    scan = {
        "sampling_frequency": echoes.sample_rate_hz,
        "center_frequency": echoes.carrier_hz,
        "demodulation_frequency": echoes.carrier_hz,
        "sound_speed": echoes.sound_speed_m_per_s,
        "initial_times": np.full(pulses, echoes.first_sample_s),
        "time_to_next_transmit": intervals_s,
        "t0_delays": np.zeros((pulses, 1)),
        "tx_apodizations": np.ones((pulses, 1)),
        "focus_distances": np.full(pulses, echoes.focus_m),
        "transmit_origins": np.zeros((pulses, 3)),
        "polar_angles": np.zeros(pulses),
    }
    for name, value in scan.items():
        file[f"tracks/track_0/scan/{name}"] = np.asarray(value, np.float32)
    file["probe/name"], file["probe/type"] = "hpe_rig", "single element"
    file["probe/probe_geometry"] = np.zeros((1, 3), np.float32)
    return missing


def _write_uff(file: h5py.File, echoes: Echoes) -> Int64Array:
    """Write an object ``channel_data`` of USTB: volts (frame, wave, channel, sample), one wave for each pulse."""
    shots, pulses, samples = echoes.shape
    # USTB reads an array of one text.
    file.attrs["version"] = np.array([UFF_VERSION.encode()])
    channel_data = _uff_object(file, "channel_data")
    data = channel_data.create_dataset("data", (shots, pulses, 1, samples), "f4")
    data.attrs.update(_uff_attributes("data", "single"))
    missing = np.zeros(shots, np.int64)
    for shot in range(shots):
        for pulses_of_block, volts in echoes.volts(shot):
            data[shot, pulses_of_block, 0] = volts
            missing[shot] += np.isnan(volts[:, 0]).sum()
    intervals_s = np.diff(echoes.pulse_time_s[0])
    numbers = {
        "sampling_frequency": echoes.sample_rate_hz,
        "initial_time": echoes.first_sample_s,
        "modulation_frequency": 0.0,
        "sound_speed": echoes.sound_speed_m_per_s,
        "PRF": 1 / float(intervals_s.mean()),
    }
    _uff_numbers(channel_data, numbers)
    _uff_numbers(_uff_object(channel_data, "pulse"), {"center_frequency": echoes.carrier_hz})
    # x, y, z, azimuth, elevation, width and height of the element.
    _uff_numbers(_uff_object(channel_data, "probe"), {"geometry": np.zeros((7, 1))})
    sequence = _uff_object(channel_data, "sequence", "wave", pulses)
    wave = sequence if pulses == 1 else _uff_object(sequence, "sequence_0001", "wave")
    _uff_numbers(wave, {"delay": 0.0, "sound_speed": echoes.sound_speed_m_per_s, "wavefront": SPHERICAL_WAVE})
    wave["wavefront"].attrs["class"] = np.bytes_("uff.wavefront")
    source = _uff_object(wave, "source", "point")
    _uff_numbers(source, {"distance": echoes.focus_m, "azimuth": 0.0, "elevation": 0.0})
    for number in range(2, pulses + 1):
        # All waves are alike: one object with many names.
        sequence[f"sequence_{number:04d}"] = wave
    return missing


def _uff_object(group: h5py.Group, name: str, kind: str = "", count: int = 1) -> h5py.Group:
    """Return a new group for an object of USTB, or for ``count`` of them; ``kind``: its class, if not ``name``."""
    item = group.create_group(name)
    item.attrs.update(_uff_attributes(name, f"uff.{kind or name}"))
    item.attrs["array"], item.attrs["size"] = np.array([float(count > 1)]), np.array([1.0, count])
    return item


def _uff_numbers(group: h5py.Group, values: Mapping[str, ArrayLike]) -> None:
    for name, value in values.items():
        group[name] = np.atleast_2d(np.asarray(value, np.float64))
        group[name].attrs.update(_uff_attributes(name, "double"))


def _uff_attributes(name: str, kind: str) -> dict[str, Any]:
    """Return the attributes of an object or a real array."""
    return {
        "class": np.bytes_(kind),
        "name": np.bytes_(name),
        "complex": np.array([0.0]),
        "imaginary": np.array([0.0]),
    }
