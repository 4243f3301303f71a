"""Binary files of oscilloscopes, read by the package RigolWFM of the extra ``oscilloscope``.

It knows files of Agilent, Keysight, LeCroy, Rigol, Rohde & Schwarz, Siglent, Tektronix and Yokogawa. Segments of LeCroy
and frames of Tektronix, one for each trigger, become pulses.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.recordings.contents import Contents
from hpe_rig.recordings.coordinates import align_records
from hpe_rig.recordings.settings import RecordingSettings

MAGIC = (b"AG01", b"AG03", b"AG10", b"RG01", b"RG03", b"<?xm")
"""First bytes of files with the suffix .bin of Agilent, Keysight, Rigol and Rohde & Schwarz."""
WAVE_DESCRIPTOR = b"WAVEDESC"
BYTE_ORDER_OFFSET = 34
"""Byte of LeCroy's wave descriptor that is 1 for little-endian numbers."""


def is_oscilloscope_file(path: Path) -> bool:
    """Return whether the first bytes of ``path`` are those of an oscilloscope."""
    with path.open("rb") as file:
        return file.read(4) in MAGIC


def read_oscilloscope(path: Path, settings: RecordingSettings) -> Contents:
    """Return the volts of a file (line, pulse, sample), one line for each channel, and the settings in its header."""
    try:
        from RigolWFM.wfm import Wfm
    except ImportError:
        raise ValueError(
            "binary files of oscilloscopes need the package RigolWFM: pip install 'hpe-rig[oscilloscope]', "
            "or save it as CSV"
        ) from None
    try:
        first = Wfm.from_file(str(path))
        frames = [first, *(Wfm.from_file(str(path), frame=frame) for frame in range(1, first.frame_count))]
        volts = np.array([[frame.channels[index].volts for frame in frames] for index in range(len(first.channels))])
        if not volts.size:
            raise ValueError("no analog channel is stored in it")
        channel = first.channels[0]
        interval_s = float(channel.seconds_per_point)
        start_s = np.array([float(frame.channels[0].times[0]) for frame in frames])
        trigger_s, segment_start_s = _lecroy_segments(path.read_bytes())
    except Exception as error:
        # The package raises errors of many types for damaged files.
        why = str(error).partition("\n")[0][:160] or type(error).__name__
        raise ValueError(f"it is no oscilloscope file that RigolWFM reads ({why}): save it as CSV") from error
    # Headers hold the interval in single precision.
    stated: dict[str, tuple[Any, str]] = {"sample_rate_hz": (float(f"{1 / interval_s:.7g}"), "the header")}
    if trigger_s.size > 1:
        if volts.shape[-1] % trigger_s.size:
            raise ValueError(f"its {trigger_s.size} segments have unequal lengths: segments of one length")
        volts, start_s = volts.reshape(len(volts), trigger_s.size, -1), segment_start_s
        stated["pulse_time_s"] = (tuple((trigger_s - trigger_s[0]).tolist()), "the times of the triggers")
    stated["first_sample_s"] = (float(start_s[0]), "the header")
    inferred = ["time 0 of the file counts as the onset of the pulse", *_names_of_lines(first.channels)]
    if start_s.size > 1:
        aligned, sentence = align_records(volts.swapaxes(0, 1), (start_s - start_s[0]) / interval_s)
        volts = aligned.swapaxes(0, 1)
        inferred += [sentence] if sentence else []
    if volts.shape[1] == 1:
        return Contents({path.stem: volts[:, 0]}, stated, axes=("line", "sample"), inferred=tuple(inferred))
    return Contents({path.stem: volts}, stated, axes=("line", "pulse", "sample"), inferred=tuple(inferred))


def _names_of_lines(channels: list[Any]) -> list[str]:
    names = ", ".join(f"{number} is {channel.name}" for number, channel in enumerate(channels, 1))
    return [f"channels are lines: {names}"] if len(channels) > 1 else []


def _lecroy_segments(data: bytes) -> tuple[FloatArray, FloatArray]:
    """Return the times of the triggers of LeCroy's segments and of their first samples after these, s (segment,)."""
    position = data.find(WAVE_DESCRIPTOR)
    if position < 0 or b"LECROY_2_3" not in data[position : position + 32]:
        return np.zeros(0), np.zeros(0)
    from RigolWFM import lecroy_2_3_be_trc, lecroy_2_3_le_trc

    is_little = data[position + BYTE_ORDER_OFFSET] == 1
    parser: Any = lecroy_2_3_le_trc.Lecroy23LeTrc if is_little else lecroy_2_3_be_trc.Lecroy23BeTrc
    entries = parser.from_bytes(data[position:]).trigtime_array or []
    times = [(entry.trigger_time, entry.trigger_offset) for entry in entries]
    return np.array([time for time, _ in times]), np.array([start for _, start in times])
