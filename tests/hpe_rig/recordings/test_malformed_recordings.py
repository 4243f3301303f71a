"""What is wrong with a recording is said at once, each mistake in one line, and no run file is made."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.io import savemat

import hpe_rig as hpe
from hpe_rig.recordings import matlab
from hpe_rig.recordings.axes import select_lines
from hpe_rig.scene import Mistake, SettingsError

PULSES, SAMPLES, LINES = 40, 160, 3
RATES = {"sample_rate_hz": 50e6, "pulse_rate_hz": 4000.0, "carrier_hz": 5e6}
TIME_S = np.arange(PULSES) / 4000.0
PHASE_RAD = 0.2 * np.pi * np.arange(SAMPLES) + 0.1 * np.arange(PULSES)[:, None]
RF = np.arange(1.0, 4.0)[:, None, None] * np.cos(PHASE_RAD)
"""Echoes (line, pulse, sample) at the carrier."""


@pytest.fixture
def scene(scene_of_gate: Callable[[float, float, float], Path]) -> Path:
    """Return a scene with a gate of 1 mm at 1.2 mm."""
    return scene_of_gate(1.2e-3, 1.0e-3, 200.0)


@pytest.mark.parametrize("text", ["", "0", "4", "3-1", "1-9", "x", "mean:7", "1,2", "-1", "1-"])
def test_lines_that_do_not_exist_are_a_mistake(text: str) -> None:
    assert isinstance(select_lines(text, 3), Mistake)


GOOD: Mapping[str, Any] = RATES | {"axes": "pulse,sample"}
BOARD = {"board": "ATS460", "record_samples": SAMPLES, "input_range_v": 1.0}


def _with(index: Any, value: float) -> NDArray[np.float64]:
    spoilt = RF[0].copy()
    spoilt[index] = value
    return spoilt


def _without(key: str) -> dict[str, Any]:
    return {name: value for name, value in GOOD.items() if name != key}


def mat_of_another_type() -> bytes:
    """Return a MATLAB file whose one array has the type 255, at which SciPy 1.17 ends the interpreter."""
    file = io.BytesIO()
    savemat(file, {"rf": np.arange(40.0).reshape(5, 8)})
    content = bytearray(file.getvalue())
    content[content.index((9).to_bytes(4, "little") + (40 * 8).to_bytes(4, "little"))] = 255
    return bytes(content)


MALFORMED: dict[str, tuple[str, Any, Mapping[str, Any], str]] = {
    # file, what it holds (bytes, array or arrays by name), settings, a part of the message
    "empty npy": ("a.npy", b"", GOOD, "it is empty"),
    "text as npy": ("a.npy", b"hello world", GOOD, "no whole NPY file"),
    "cut npy": ("a.npy", b"\x93NUMPY\x01\x00v\x00", GOOD, "no whole NPY file"),
    "pickled npy": ("a.npy", np.array([{}]), GOOD, "holds Python objects"),
    "texts as npy": ("a.npy", np.array([["a", "b"]]), GOOD, "no array of numbers"),
    "one axis": ("a.npy", RF[0, 0], GOOD, "pulse, sample are 2 axes, 'a' has 1"),
    "five axes": ("a.npy", np.ones((2, 2, 2, 2, 2)), {**GOOD, "axes": None}, "5 axes"),
    "three axes of two": ("a.npy", RF, GOOD, "are 2 axes, 'a' has 3"),
    "unstated order": ("a.npy", RF[0], _without("axes"), "the order of axes"),
    "axis twice": ("a.npy", RF[0], {**GOOD, "axes": "pulse,pulse"}, "named twice"),
    "no pulse axis": ("a.npy", RF[0], {**GOOD, "axes": "line,sample"}, "axes lacks pulse, such as"),
    "unknown axis": ("a.npy", RF[0], {**GOOD, "axes": "pulse,depth"}, "not one of the choices"),
    "iq of three": ("a.npy", RF[0][..., :3, None].repeat(3, -1), {**GOOD, "axes": "pulse,sample,iq"}, "length of 3"),
    "one pulse": ("a.npy", RF[0, :1], GOOD, "1 pulses of 160 samples carry no motion"),
    "seven samples": ("a.npy", RF[0, :, :7], GOOD, "40 pulses of 7 samples"),
    "three pulses": ("a.npy", RF[0, :3], GOOD, "do not determine a vibration"),
    "nan": ("a.npy", _with((3, 7), np.nan), GOOD, "1 of 40 records hold values that are not finite"),
    "infinite": ("a.npy", _with(slice(None), np.inf), GOOD, "40 of 40 records"),
    "no rate": ("a.npy", RF[0], _without("sample_rate_hz"), "sample_rate_hz: neither"),
    "no pulse rate": ("a.npy", RF[0], _without("pulse_rate_hz"), "pulse_rate_hz: neither"),
    "no carrier": ("a.npy", RF[0], _without("carrier_hz"), "carrier_hz: neither"),
    "negative rate": ("a.npy", RF[0], {**GOOD, "sample_rate_hz": -1.0}, "sample_rate_hz: -1.0 is out of bounds"),
    "rate in MHz": ("a.npy", RF[0], {**GOOD, "sample_rate_hz": 50.0}, "does not fit a sampling rate"),
    "rate of text": ("a.npy", RF[0], {**GOOD, "pulse_rate_hz": "fast"}, "is not a number"),
    "carrier above": ("a.npy", RF[0], {**GOOD, "carrier_hz": 30e6}, "carrier of 3e+07 Hz does not fit"),
    "misspelt key": ("a.npy", RF[0], {**GOOD, "carier_hz": 5e6}, "did you mean carrier_hz"),
    "demodulated rf": ("a.npy", RF[0], {**GOOD, "demodulation_hz": 5e6}, "the samples are real"),
    "iq unmixed": ("a.npy", RF[0] + 1j, GOOD, "demodulation_hz: neither"),
    "times fall": ("a.npy", RF[0], {**_without("pulse_rate_hz"), "pulse_time_s": TIME_S[::-1].tolist()}, "not ascend"),
    "times too few": ("a.npy", RF[0], {**_without("pulse_rate_hz"), "pulse_time_s": [0.0, 1e-3]}, "2 times"),
    "times before 0": (
        "a.npy",
        RF[0],
        {**_without("pulse_rate_hz"), "pulse_time_s": (TIME_S - 1).tolist()},
        "seconds from 0 on",
    ),
    "times and rate": ("a.npy", RF[0], {**GOOD, "pulse_time_s": TIME_S.tolist()}, "exclude each other"),
    "samples outside": ("a.npy", RF[0], {**GOOD, "samples": [0, 999]}, "exceeds the 160 samples"),
    "samples backwards": ("a.npy", RF[0], {**GOOD, "samples": [90, 10]}, "ends before it begins"),
    "depth alone": ("a.npy", RF[0], {**GOOD, "first_sample_depth_m": 1e-3}, "a depth needs a sound speed"),
    "gate outside": ("a.npy", RF[0], {**GOOD, "first_sample_s": 1e-4}, "the gate takes samples"),
    "line outside": ("a.npy", RF[0], {**GOOD, "lines": "2"}, "not within the 1 lines"),
    "no line chosen": ("a.npy", RF, {**GOOD, "axes": "line,pulse,sample"}, "3 lines and none is selected"),
    "positions unknown": (
        "a.npy",
        RF,
        {**GOOD, "axes": "line,pulse,sample", "lines": "all"},
        "their positions are not stated",
    ),
    "positions few": (
        "a.npy",
        RF,
        {**GOOD, "axes": "line,pulse,sample", "lines": "all", "line_position_m": [0.0]},
        "1 positions for 3 lines",
    ),
    "shots": ("a.npy", RF, {**GOOD, "axes": "shot,pulse,sample", "lines": "mean:2"}, "not within the 1 lines"),
    "text as npz": ("a.npz", b"PK\x03\x04rubbish", GOOD, "no whole NPZ file"),
    "npz of numbers": ("a.npz", {"fs": np.array(1.0)}, GOOD, "no array of numbers"),
    "npz of two": ("a.npz", {"a": RF[0], "b": RF[0]}, GOOD, "several arrays may be the samples: a, b"),
    "npz without": ("a.npz", {"a": RF[0]}, {**GOOD, "variable": "rf"}, "'rf' is no array"),
    "npz of bad rate": ("a.npz", {"a": RF[0], "fs": np.array(-5.0)}, _without("sample_rate_hz"), "'fs' of the file"),
    "text as mat": ("a.mat", b"MATLAB 4.2" * 20, GOOD, "MATLAB file"),
    "mat of another type": ("a.mat", mat_of_another_type(), GOOD, "MATLAB file"),
    "empty mat": ("a.mat", {"mat": {"x": np.array(2.0)}}, GOOD, "no array of numbers"),
    "text as hdf5": ("a.h5", b"\x89HDF\r\n\x1a\n" + b"0" * 100, GOOD, "no readable HDF5 file"),
    "csv of words": ("a.csv", b"1,2,3\n4,five,6\n", GOOD, "line 2 has values that are not numbers"),
    "ragged csv": ("a.csv", b"1,2,3\n4,5\n", GOOD, "line 2 has 2 values"),
    "csv of comments": ("a.csv", b"# nothing\n", GOOD, "no line of numbers"),
    "csv of bytes": ("a.csv", b"\xff\xfe\x00", GOOD, "no utf-16 text"),
    "raw unsaid": ("a.raw", b"1234", GOOD, "needs dtype and shape"),
    "raw too short": ("a.raw", b"1234", {**GOOD, "dtype": "int16", "shape": [40, 160]}, "it has 4 bytes"),
    "raw of no type": ("a.raw", b"1234", {**GOOD, "dtype": "int12", "shape": [2, 1]}, "not one of the choices"),
    "alazar unsaid": ("a.alz", b"1234", GOOD, "does not state board and record_samples"),
    "alazar cut": ("a.alz", b"1234", {**GOOD, **BOARD}, "no whole records"),
    "alazar other board": ("a.alz", b"1234", {**GOOD, **BOARD, "board": "ATS1"}, "not one of the choices"),
    "alazar channel B": ("a.alz", bytes(320 * 40), {**GOOD, **BOARD, "channel": "B"}, "channels = 2"),
    "alazar without range": (
        "a.alz",
        bytes(320 * 40),
        {**GOOD, "board": "ATS460", "record_samples": SAMPLES},
        "the input range is not stated",
    ),
    "alazar buffers": ("a.alz", bytes(320 * 40), {**GOOD, **BOARD, "records_per_buffer": 7}, "no whole buffers"),
    "no ending": ("a", b"12345678", GOOD, "a file without suffix implies no format"),
    "unknown ending": ("a.xyz", b"12345678", GOOD, "the suffix .xyz implies no format"),
    "unknown format": ("a.npy", RF[0], {**GOOD, "format": "npyy"}, "did you mean npy"),
    "absent": ("b.npy", None, GOOD, "does not exist"),
}


def test_a_matlab_file_that_takes_too_long_to_read_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(matlab, "TIMEOUT_S", 0.0)
    (tmp_path / "a.mat").write_bytes(mat_of_another_type())
    with pytest.raises(ValueError, match=r"not read within 0 s\): save it anew"):
        matlab.matlab_to_npz(tmp_path / "a.mat", tmp_path / "a.npz", 1_000_000)


# SciPy reads these in a process of its own; "mat of another type" is the default one of them.
OWN_PROCESS = ("text as mat", "empty mat")


@pytest.mark.parametrize(
    "case", [pytest.param(case, marks=[pytest.mark.slow] if case in OWN_PROCESS else []) for case in MALFORMED]
)
def test_a_malformed_recording_is_refused_with_one_clear_message(case: str, scene: Path, tmp_path: Path) -> None:
    from hpe_rig.plan import PlanError

    name, holds, settings, said = MALFORMED[case]
    path = tmp_path / name
    if isinstance(holds, bytes):
        path.write_bytes(holds)
    elif isinstance(holds, dict) and "mat" in holds:
        savemat(path, holds["mat"])
    elif isinstance(holds, dict):
        np.savez(path, **holds)
    elif holds is not None:
        np.save(path, holds, allow_pickle=True)
    stated = {key: value for key, value in settings.items() if value is not None}
    with pytest.raises((SettingsError, PlanError)) as refused:
        hpe.import_records(path, scene, tmp_path / "run.h5", **stated)
    text = str(refused.value)
    assert said in text
    assert "Try: " in text or "did you mean" in text
    assert not (tmp_path / "run.h5").exists()
    assert sum(said in line for line in text.splitlines()) == 1


def test_all_mistakes_of_a_recording_are_reported_at_once(scene: Path) -> None:
    spoilt = _with((3, 7), np.nan)
    options: dict[str, Any] = {"axes": "pulse,sample", "lines": "9", "samples": [0, 999], "skip_rows": 3}
    options["dtype"] = "int16"
    with pytest.raises(SettingsError) as refused:
        hpe.import_records(spoilt, scene, scene.parent / "run.h5", **options)
    text = str(refused.value)
    for part in (
        "sample_rate_hz",
        "pulse_rate_hz",
        "carrier_hz",
        "not finite",
        "lines: '9'",
        "samples: 0 to 999",
        "uses skip_rows",
        "uses dtype",
    ):
        assert part in text
