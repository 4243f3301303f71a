"""Layouts of research scanners in MATLAB and HDF5 files: UFF of USTB, zea, buffers of Verasonics; exported runs.

UFF stores samples as (frame, wave, channel, sample) and pixels as (frame, wave, channel, pixel), the depth fastest; zea
as (frame, transmit, sample, element, component). Verasonics stores ``RcvData`` as (row, channel, frame), where the rows
of a frame hold one acquisition after the other. A file with one transmit per frame has the frames as pulses. Otherwise
the transmits are the pulses and the frames are the shots.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpe_rig.recordings.contents import Contents
from hpe_rig.recordings.export_files import CODES, LABEL_GROUPS
from hpe_rig.recordings.settings import Dimension
from hpe_rig.store import MISSING

Values = Mapping[str, NDArray[Any]]
"""Numbers and arrays of a file by their path."""
Stated = dict[str, tuple[Any, str]]
"""Settings by key, each with its name in the file."""
SAME_RATIO = 1e-3
"""Largest relative difference between times that count as equal."""
SAME_DELAY_S = 1e-10
"""Largest difference between the delays of waves that count as equal: a hundredth of a sample at 100 MHz."""
MAX_CODE_ROUNDING = 0.02
"""Largest distance of exported volts from a code, in codes: single precision rounds 32767 codes by 0.002."""
UFF_SIBLINGS = ("modulation_frequency", "initial_time", "scan/z_axis")
"""Values that are only in the group of samples or pixels of UFF."""
EXPORTED_KEYS = ("sample_rate_hz", "carrier_hz", "sound_speed_m_per_s", "first_sample_s", "scale_v")
"""Settings that an exported file states under their own names."""


def scanner_contents(values: Values, variable: str | None) -> Contents | None:
    """Return the samples of a file in the layout of a scanner, None for another layout.

    ``variable``: path of the samples if the file holds several. Raises ``ValueError`` "mistake: remedy".
    """
    layouts: tuple[tuple[str, tuple[int, ...], Callable[[Values, str], Contents]], ...] = (
        ("data/raw_data", (5,), _zea),
        ("data/real", (3, 4), _uff),
        ("data", (2, 3, 4), _uff),
        ("RcvData", (2, 3, 4), _verasonics),
        (CODES, (2, 3), _exported),
    )
    for suffix, axis_counts, read in layouts:
        names = [name for name in values if name == suffix or name.endswith(f"/{suffix}")]
        names = [name for name in names if values[name].ndim in axis_counts]
        if suffix == "data":
            names = [name for name in names if any(f"{_owner(name)}/{key}" in values for key in UFF_SIBLINGS)]
        if variable is not None:
            names = [name for name in names if variable.strip("/") in (name, name.removesuffix("/real"))]
        if len(names) > 1:
            listed = [name.removesuffix("/real") for name in names]
            raise ValueError(f'it holds the samples {", ".join(listed)}: variable = "{listed[0]}"')
        if names:
            return read(values, names[0])
    return None


def _zea(values: Values, name: str) -> Contents:
    """Return the samples of a zea file."""
    array, scan = values[name], name.removesuffix("data/raw_data") + "scan"
    stated = _numbers(
        values,
        (
            ("sample_rate_hz", f"{scan}/sampling_frequency"),
            ("carrier_hz", f"{scan}/center_frequency"),
            ("demodulation_hz", f"{scan}/demodulation_frequency"),
            ("sound_speed_m_per_s", f"{scan}/sound_speed"),
            ("first_sample_s", f"{scan}/initial_times"),
        ),
    )
    component: tuple[Dimension, ...] = () if array.shape[-1] == 1 else ("iq",)
    if not component:
        # The frequency at which zea would demodulate real samples.
        stated.pop("demodulation_hz", None)
    array = array if component else array[..., 0]
    array, axes, text = _pulses(array, ("sample", "line", *component), "transmit")
    interval = f"{scan}/time_to_next_transmit"
    if interval in values and array.shape[axes.index("pulse")] > 1:
        # Each interval follows its pulse, so the last one of a train is not needed.
        trains = np.atleast_2d(np.asarray(values[interval], np.float64))
        interval_s = trains.reshape(-1) if "shot" not in axes else trains[0]
        if "shot" in axes and not np.allclose(trains, interval_s, rtol=SAME_RATIO):
            raise ValueError(f"{interval} differs between frames: one file per frame, or pulse_rate_hz")
        stated["pulse_time_s"] = (tuple(np.cumsum([0.0, *interval_s[:-1]]).tolist()), interval)
    array, stated = _with_exported(values, LABEL_GROUPS["zea"], array, stated)
    return Contents({name: array}, stated, axes, inferred=(f"zea: {text}",))


def _uff(values: Values, name: str) -> Contents:
    """Return the samples or the pixels of an object in a UFF file of USTB."""
    data = name.removesuffix("/real")
    owner = _owner(data)
    real, imag = values[name], values.get(f"{data}/imag")
    if imag is not None and imag.shape != real.shape:
        raise ValueError(
            f"{data} has a real part of {real.shape} and an imaginary part of {imag.shape}: the whole file"
        )
    stated = _numbers(
        values,
        (
            ("sample_rate_hz", f"{owner}/sampling_frequency"),
            ("pulse_rate_hz", f"{owner}/PRF"),
            ("pulse_rate_hz", f"{owner}/prf"),
            ("pulse_rate_hz", f"{owner}/frame_rate"),
            ("carrier_hz", f"{owner}/pulse/center_frequency"),
            ("carrier_hz", f"{owner}/modulation_frequency"),
            ("demodulation_hz", f"{owner}/modulation_frequency"),
            ("sound_speed_m_per_s", f"{owner}/sound_speed"),
            ("first_sample_s", f"{owner}/initial_time"),
        ),
    )
    array = real if imag is None or not imag.any() else real + 1j * imag
    # MATLAB omits trailing axes of length 1, which come first in HDF5.
    array = array.reshape((1,) * (4 - array.ndim) + array.shape)
    if np.isrealobj(array):
        stated.pop("demodulation_hz", None)
    if stated.get("carrier_hz", (1.0, ""))[0] == 0:
        del stated["carrier_hz"]
    pixels = _with_pixels(values, owner, array, stated)
    # The depths of pixels contain the delays of their waves.
    if pixels is array and (delay_s := _wave_delay_s(values, f"{owner}/sequence")):
        start_s, origin = stated.get("first_sample_s", (0.0, f"{owner}/initial_time"))
        stated["first_sample_s"] = (start_s + delay_s, f"{origin} and sequence/delay")
    array, axes, text = _pulses(pixels, ("line", "sample"), "wave")
    array, stated = _with_exported(values, LABEL_GROUPS["uff"], array, stated)
    return Contents({data: array}, stated, axes, inferred=(f"UFF: {text}",))


def _owner(data: str) -> str:
    """Return the path of the group that holds the dataset ``data`` of UFF."""
    return data.removesuffix("data").removesuffix("/")


def _wave_delay_s(values: Values, sequence: str) -> float:
    """Return the time from the reference time of a wave to the initial time of its samples; 0 without any."""
    delays_s = [
        float(np.ravel(value)[0])
        for name, value in values.items()
        if name.startswith(f"{sequence}/") and name.endswith("/delay") and value.size
    ]
    if not delays_s:
        return 0.0
    if max(delays_s) - min(delays_s) > SAME_DELAY_S:
        extremes = f"{min(delays_s):g} to {max(delays_s):g} s"
        raise ValueError(f"{sequence}/delay differs between waves ({extremes}): waves of one kind alone")
    return delays_s[0]


def _with_pixels(values: Values, owner: str, array: NDArray[Any], stated: Stated) -> NDArray[Any]:
    """Return pixels (..., 1, pixel) of a linear scan as (..., line, depth), and state their rate; samples unchanged."""
    scan = f"{owner}/scan"
    x_m, z_m = (np.ravel(values.get(f"{scan}/{axis}_axis", ())) for axis in "xz")
    if not x_m.size or z_m.size < 2 or x_m.size * z_m.size != array.shape[-1]:
        return array
    if "sound_speed_m_per_s" not in stated:
        raise ValueError(f"{owner} states depths of pixels and no sound_speed: sound_speed in the file, or its samples")
    speed_m_per_s = stated["sound_speed_m_per_s"][0]
    depths = f"{scan}/z_axis"
    rate_hz = speed_m_per_s * (z_m.size - 1) / (2 * float(z_m[-1] - z_m[0]))
    stated["sample_rate_hz"] = (float(f"{rate_hz:.9g}"), depths)
    stated["first_sample_s"] = (2 * float(z_m[0]) / speed_m_per_s, depths)
    stated["line_position_m"] = (tuple(x_m.astype(float).tolist()), f"{scan}/x_axis")
    return array.reshape(*array.shape[:2], x_m.size, z_m.size)


def _verasonics(values: Values, name: str) -> Contents:
    """Return the acquisitions in the receive buffer of a Verasonics file."""
    rows, buffers = values[name], _column(values, "Receive.bufnum")
    if rows.ndim == 4 or (buffers is not None and buffers.max() > 1):
        raise ValueError(
            f"RcvData holds several buffers ({rows.shape}): only that of the tracking pulses, RcvData = RcvData(1)"
        )
    rows = rows.reshape(*rows.shape[:2], -1)
    stated: Stated = {}
    for key, path, factor in (
        ("sample_rate_hz", "Receive.decimSampleRate", 1e6),
        ("carrier_hz", "Receive.demodFrequency", 1e6),
        ("carrier_hz", "Trans.frequency", 1e6),
        ("sound_speed_m_per_s", "Resource.Parameters.speedOfSound", 1.0),
    ):
        if key not in stated and (number := _number(values, path)) is not None:
            stated[key] = (number * factor, path)
    interval_s, interval_text = _intervals(values)
    if interval_s is not None:
        stated["pulse_rate_hz"] = (float(f"{1 / interval_s:.9g}"), "SeqControl.timeToNextAcq")
    if start := _number(values, "Receive.startDepth"):
        # Depths are in wavelengths of the transducer's frequency.
        frequency_mhz = _number(values, "Trans.frequency")
        if frequency_mhz is None:
            raise ValueError("Receive.startDepth is in wavelengths, and Trans.frequency is absent: save Trans as well")
        stated["first_sample_s"] = (2 * start / frequency_mhz / 1e6, "Receive.startDepth")
    records = rows[_record_rows(values, rows.shape[0])].transpose(3, 0, 2, 1)
    array, axes, text = _pulses(records, ("line", "sample"), "acquisition")
    array, stated = _unpack_quadrature(values, array, stated)
    return Contents({name: array}, stated, axes, inferred=(f"Verasonics: {text}{interval_text}",))


def _exported(values: Values, name: str) -> Contents:
    """Return the codes (sample, pulse, shot) of a run that was exported to MATLAB."""
    codes = values[name].reshape(*values[name].shape[:2], -1)
    stated = _exported_settings(values, "")
    if (codes == MISSING).any() and "scale_v" in stated:
        volts = codes * stated.pop("scale_v")[0] + (_number(values, "offset_v") or 0.0)
        codes = np.where(codes == MISSING, np.nan, volts)
    return Contents({name: codes}, stated, ("sample", "pulse", "shot"), inferred=("MATLAB: a run of hpe_rig",))


def _with_exported(values: Values, group: str, array: NDArray[Any], stated: Stated) -> tuple[NDArray[Any], Stated]:
    """Return the codes and settings of volts that hpe_rig exported, with values in ``group``; others unchanged.

    Volts that are no codes are returned as volts: NaN of a missing record, and echoes that were changed since.
    """
    exported = _exported_settings(values, f"{group}/")
    if not exported:
        return array, stated
    scale_v, origin = exported.pop("scale_v")
    codes = (array - (_number(values, f"{group}/offset_v") or 0.0)) / scale_v
    rounded = np.rint(codes)
    with np.errstate(invalid="ignore"):
        # NaN fails the comparison.
        are_codes = np.abs(codes - rounded).max() < MAX_CODE_ROUNDING and np.abs(codes).max() <= np.iinfo(np.int16).max
    if are_codes:
        array, exported["scale_v"] = rounded.astype(np.int16), (scale_v, origin)
    return array, stated | exported


def _exported_settings(values: Values, group: str) -> Stated:
    """Return the settings that hpe_rig wrote under their own names in ``group``; empty for a file of others."""
    times_s = values.get(f"{group}pulse_time_s")
    exported = _numbers(values, ((key, f"{group}{key}") for key in EXPORTED_KEYS))
    if times_s is None or exported.keys() != set(EXPORTED_KEYS):
        return {}
    # MATLAB counts the shots along the last axis.
    times_s = times_s if group else times_s.T
    if key := differing_setting(times_s, values.get(f"{group}lateral_offset_m")):
        raise ValueError(f"its shots differ in {key}: hpe-rig export RUN.h5 --shot for shots of one {key}")
    return exported | {"pulse_time_s": (tuple(times_s[0].tolist()), f"{group}pulse_time_s")}


def differing_setting(pulse_time_s: NDArray[Any], lateral_offset_m: NDArray[Any] | None) -> str | None:
    """Return the name of the first setting in which the shots of an exported run differ; an import has one value of it.

    ``pulse_time_s`` (shot, pulse); ``lateral_offset_m`` (shot,), or None if unknown.
    """
    for name, rows in (("pulse_time_s", pulse_time_s), ("lateral_offset_m", lateral_offset_m)):
        if rows is not None and np.ptp(rows.reshape(len(pulse_time_s), -1), axis=0).max() > SAME_DELAY_S:
            return name
    return None


def _record_rows(values: Values, count: int) -> NDArray[np.intp]:
    """Return the rows of every acquisition of a frame with ``count`` rows, (acquisition, sample)."""
    first, end = (_column(values, f"Receive.{key}") for key in ("startSample", "endSample"))
    if first is None or end is None or first.size != end.size:
        return np.arange(count)[None]
    of_frame = np.ones(first.size, np.bool_)
    frames = _column(values, "Receive.framenum")
    if frames is not None and frames.size == first.size:
        of_frame = frames == frames[0]
    # Receive has several structures for the same rows if they accumulate.
    spans = np.unique(np.column_stack([first[of_frame], end[of_frame]]), axis=0).astype(np.intp)
    lengths = spans[:, 1] - spans[:, 0] + 1
    if not lengths.size or lengths.min() != lengths.max() or lengths[0] < 1:
        listed = ", ".join(map(str, np.unique(lengths).tolist()[:4]))
        raise ValueError(f"the acquisitions have {listed} samples: one length, startSample to endSample of Receive")
    if spans.min() < 1 or spans.max() > count:
        raise ValueError(
            f"Receive ends at sample {spans.max()}, the frame has {count} rows: RcvData and Receive of one measurement"
        )
    return np.asarray(spans[:, :1] - 1 + np.arange(lengths[0]), np.intp)


def _intervals(values: Values) -> tuple[float | None, str]:
    """Return the shortest time between acquisitions, and a sentence about longer ones."""
    interval_us = _column(values, "SeqControl.timeToNextAcq")
    if interval_us is None or not interval_us.min() > 0:
        return None, ""
    listed = ", ".join(f"{time:g}" for time in np.unique(interval_us)[:4])
    more = "" if interval_us.min() == interval_us.max() else f"; the shortest timeToNextAcq of {listed} us counts"
    return float(interval_us.min()) * 1e-6, more


def _unpack_quadrature(values: Values, array: NDArray[Any], stated: Stated) -> tuple[NDArray[Any], Stated]:
    """Return I and Q of bandwidth sampling (BS100BW, BS67BW, BS50BW); other samples unchanged.

    The scanner keeps two of ``2 quadDecim`` samples at four times the demodulation frequency f: I, and -Q a quarter of
    a period later. Q is shifted to the time of I.
    """
    decimation = _number(values, "Receive.quadDecim")
    if decimation is None and (per_wave := _number(values, "Receive.samplesPerWave")):
        decimation = 4 / per_wave
    demodulation_mhz, rate_mhz = (_number(values, f"Receive.{key}") for key in ("demodFrequency", "decimSampleRate"))
    if decimation is None or decimation <= 1:
        return array, stated
    if demodulation_mhz is None or rate_mhz is None or not np.isclose(rate_mhz, 4 * demodulation_mhz, rtol=1e-2):
        raise ValueError(
            f"samples with quadDecim = {decimation:g} at decimSampleRate = {rate_mhz} are no quadratures of "
            f"demodFrequency = {demodulation_mhz}, MHz: four times it, or sampleMode NS200BW"
        )
    rate_hz, demodulation_hz = rate_mhz * 1e6 / (2 * decimation), demodulation_mhz * 1e6
    pairs = array[..., : array.shape[-1] // 2 * 2].astype(np.float64)
    # Half a period more between pairs reverses the sign of every other one.
    signs = 1 - 2 * (np.arange(pairs.shape[-1] // 2) * round(decimation) % 2)
    in_phase, quadrature = pairs[..., ::2] * signs, -pairs[..., 1::2] * signs
    delays = np.exp(-2j * np.pi * np.fft.rfftfreq(quadrature.shape[-1], 1 / rate_hz) / (4 * demodulation_hz))
    samples = in_phase + 1j * np.fft.irfft(np.fft.rfft(quadrature) * delays, quadrature.shape[-1])
    name = "Receive.quadDecim"
    return samples, stated | {
        "sample_rate_hz": (rate_hz, name),
        "demodulation_hz": (demodulation_hz, "Receive.demodFrequency"),
    }


def _pulses(
    array: NDArray[Any], axes: tuple[Dimension, ...], transmit: str
) -> tuple[NDArray[Any], tuple[Dimension, ...], str]:
    """Return (frame, transmit, ...) with the pulses on one axis, the names of all axes, and a sentence about them."""
    frames, transmits = array.shape[:2]
    if transmits == 1:
        return (array[:, 0], ("pulse", *axes), f"{frames} frames of one {transmit} are the pulses")
    if frames == 1:
        return array[0], ("pulse", *axes), f"{transmits} {transmit}s are the pulses"
    text = f"{transmits} {transmit}s of each frame are the pulses, {frames} frames are the shots"
    return array, ("shot", "pulse", *axes), text


def _numbers(values: Values, paths: Iterable[tuple[str, str]]) -> Stated:
    """Return the numbers at ``paths`` (key, path) by key; the first that exists counts."""
    stated: Stated = {}
    for key, path in paths:
        if key not in stated and (number := _number(values, path)) is not None:
            stated[key] = (number, path)
    return stated


def _number(values: Values, path: str) -> float | None:
    """Return the number at ``path``, which is the same for all transmits; None if it is absent."""
    column = _column(values, path)
    if column is None:
        return None
    if not np.allclose(column, column[0], rtol=SAME_RATIO, atol=0):
        raise ValueError(
            f"{path} differs between transmits ({column.min():g} to {column.max():g}): transmits of one kind alone"
        )
    return float(column[0])


def _column(values: Values, path: str) -> NDArray[np.float64] | None:
    """Return the numbers at ``path``, with a dot or a slash between its parts; None if it is absent."""
    for name in (path, path.replace(".", "/")):
        if name in values and values[name].size:
            return np.real(values[name]).astype(np.float64).reshape(-1)
    return None
