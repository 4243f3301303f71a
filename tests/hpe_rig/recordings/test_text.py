"""Tables of numbers as programs and oscilloscopes write them are read without options that the file makes unnecessary.

The layouts of the vendors are written here from their documentation and from files of other people, with few numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hpe_rig.recordings import Recording, read_recording, read_settings
from hpe_rig.scene import SettingsError

PULSES, SAMPLES, INTERVAL_S = 9, 32, 2.5e-8
RF = np.random.default_rng(7).normal(size=(PULSES, SAMPLES)).round(6)
RATES = {"carrier_hz": 5e6, "pulse_rate_hz": 4e3}


def rows(delimiter: str = ",", decimal: str = ".", tail: str = "", first: Callable[[int], str] | None = None) -> str:
    """Return lines of the time of a sample and its values in all pulses."""
    first = first or (lambda sample: f"{sample * INTERVAL_S - 1e-7:.6e}")
    lines = [delimiter.join([first(k), *(f"{value:.6f}" for value in RF[:, k])]) + tail for k in range(SAMPLES)]
    return "\n".join(lines).replace(".", decimal) + "\n"


def read(path: Path, content: str | bytes, **options: Any) -> Recording:
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    settings, origins = read_settings(path, None, RATES | options)
    return read_recording(path, settings, origins)


SEGMENTS = "".join(f"#{k + 1},25-Nov-2026 13:00:00,{k * 2.5e-4:.6f}\n" for k in range(PULSES))
STACKED = "".join(f"{k * INTERVAL_S - 1e-7:.6e},{RF[p, k]:.6f}\n" for p in range(PULSES) for k in range(SAMPLES))
NAMES = "".join(f",CH1_{pulse}" for pulse in range(PULSES))
SIDE = ["Record Length,32,,", "Sample Interval,2.5e-08,,", "Source,CH1,,", "Vertical Units,V,,"]
LAYOUTS: Mapping[str, str | bytes] = {
    "tektronix": "Model,MDO3024\nFirmware Version,1.30\n\nPoint Format,Y,\nHorizontal Units,s,\nRecord Length,32,\n"
    f"Vertical Units,V,\n\nTIME{NAMES}\n{rows()}",
    "tektronix with settings beside the numbers": "\n".join(
        (SIDE[k] if k < len(SIDE) else ",,,") + line for k, line in enumerate(rows(tail=",").splitlines())
    ),
    "keysight": f"x-axis{',1' * PULSES}\nsecond{',Volt' * PULSES}\n{rows()}",
    "lecroy": f"LECROYWS10s,1,Waveform\nSegments,9,SegmentSize,32\nSegment,TrigTime,TimeSinceSegment1\n{SEGMENTS}"
    f"Time,Ampl\n{STACKED}",
    "records below each other": f"time_s,volt\n{STACKED}",
    "rigol": f"X{',CH1' * PULSES},\nSecond{',Volt' * PULSES},\n{rows(tail=',')}",
    "rigol with increment": f"X{',CH1' * PULSES},Start,Increment,\nSequence{',Volt' * PULSES},-1e-07,2.5e-08,\n"
    + rows(tail=",,,", first=str),
    "hantek": f"nr,time{NAMES}\n" + rows(first=lambda k: f"{k},{k * INTERVAL_S - 1e-7:.6e}"),
    "rohde und schwarz": f"in s{',CH1 in V' * PULSES}\n{rows()}",
    "pico": f"Time{',Channel A' * PULSES}\n(us){',(V)' * PULSES}\n\n"
    + rows(first=lambda k: f"{(k * INTERVAL_S - 1e-7) * 1e6:.8f}"),
    "decimal comma": f"Zeit{NAMES.replace(',', ';')}\n{rows(';', ',')}",
    "decimal comma and blanks": rows(" ", ","),
    "utf-16": f"Time{NAMES}\n{rows()}".replace(",", "\t").encode("utf-16"),
    "latin-1": f"t (µs){NAMES}\n{rows(first=lambda k: f'{(k * INTERVAL_S - 1e-7) * 1e6:.8f}')}".encode("latin-1"),
    "byte-order mark": b"\xef\xbb\xbf" + rows().encode(),
    "quoted": "\n".join(
        ",".join(f'"{cell}"' for cell in line.split(",")) for line in f"time (s){NAMES}\n{rows()}".splitlines()
    ),
    "comments": "# written by a script\n" + rows("\t"),
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_layout_is_read_with_its_times_and_no_option(layout: str, tmp_path: Path) -> None:
    recording = read(tmp_path / "a.csv", LAYOUTS[layout])
    np.testing.assert_allclose(recording.values[0, 0], RF, rtol=0, atol=1e-12)
    assert recording.sample_rate_hz == pytest.approx(1 / INTERVAL_S, rel=1e-8)
    assert recording.first_sample_s == pytest.approx(-1e-7, rel=1e-6)
    assert recording.pulse_rate_hz == pytest.approx(4e3)
    assert any(text.startswith(("sample_rate_hz = 4e+07, from ", "column 1")) for text in recording.inferred)


def test_settings_in_comments_are_read_with_their_units(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text(f"# fs = 40 MHz\n# prf 4 kHz\n# fc: 5 MHz\n# t0 = -0.1 us\n{rows(' ', first=str)}")
    settings, origins = read_settings(path, None, {})
    recording = read_recording(path, settings, origins)
    assert (recording.sample_rate_hz, recording.pulse_rate_hz, recording.carrier_hz) == (40e6, 4e3, 5e6)
    assert "the first pulse is fired 0 s after time zero of the pulses, the default" in recording.inferred
    assert recording.first_sample_s == pytest.approx(-1e-7)
    np.testing.assert_array_equal(recording.values[0, 0], RF)


@pytest.mark.parametrize(
    ("header", "scale_v"),
    [
        (f"Time{',Channel A' * PULSES}\n(s){',(mV)' * PULSES}\n", 1e-3),
        (f"t [s]{',CH1 [V]' * PULSES}\n", 1.0),
        (f"x-axis{',1' * PULSES}\nsecond{',µV' * PULSES}\n", 1e-6),
        (f"Vertical Units,mV,\nTIME{NAMES}\n", 1e-3),
        (f"TIME{NAMES}\n", None),
    ],
)
def test_the_unit_of_columns_is_that_of_their_values(header: str, scale_v: float | None, tmp_path: Path) -> None:
    recording = read(tmp_path / "a.csv", header + rows())
    assert recording.scale_v == scale_v
    assert any(text.startswith("scale_v = ") for text in recording.inferred) == (scale_v is not None)
    np.testing.assert_allclose(recording.values[0, 0], RF, rtol=0, atol=1e-12)


@pytest.mark.parametrize("first", [0, 1])
def test_an_index_is_no_pulse(first: int, tmp_path: Path) -> None:
    text = rows(first=lambda k: str(k + first))
    recording = read(tmp_path / "a.csv", text, sample_rate_hz=40e6, axes="sample,pulse")
    np.testing.assert_array_equal(recording.values[0, 0], RF)
    assert "column 1 counts the rows: an index, no pulse" in recording.inferred


def test_a_column_that_is_named_is_a_pulse(tmp_path: Path) -> None:
    recording = read(tmp_path / "a.csv", rows(), columns="1-9", sample_rate_hz=40e6, axes="sample,pulse")
    assert recording.values.shape == (1, 1, PULSES, SAMPLES)
    np.testing.assert_allclose(recording.values[0, 0, 0], np.arange(SAMPLES) * INTERVAL_S - 1e-7, atol=1e-13)
    some = read(tmp_path / "b.csv", rows(), columns="3,5-10")
    np.testing.assert_array_equal(some.values[0, 0], RF[[1, 3, 4, 5, 6, 7, 8]])
    assert some.sample_rate_hz == 40e6
    listed = read(tmp_path / "c.csv", rows(), columns=[3, 5, 6, 7, 8, 9, 10])
    np.testing.assert_array_equal(listed.values, some.values)


def test_rows_may_be_pulses_with_their_times(tmp_path: Path) -> None:
    lines = [f"{0.25 * p},{','.join(str(value) for value in RF[p])}" for p in range(PULSES)]
    settings, origins = read_settings(None, None, {"carrier_hz": 5e6, "sample_rate_hz": 40e6})
    path = tmp_path / "a.csv"
    path.write_text(f"time (ms){',x' * SAMPLES}\n" + "\n".join(lines))
    recording = read_recording(path, settings, origins)
    np.testing.assert_array_equal(recording.values[0, 0], RF)
    assert recording.pulse_rate_hz == pytest.approx(4e3)


def test_times_in_the_first_row_are_those_of_samples(tmp_path: Path) -> None:
    times = ",".join(f"{k * INTERVAL_S - 1e-7:.6e}" for k in range(SAMPLES))
    recording = read(tmp_path / "a.csv", "\n".join([times, *(",".join(map(str, row)) for row in RF)]))
    np.testing.assert_array_equal(recording.values[0, 0], RF)
    assert recording.first_sample_s == pytest.approx(-1e-7)


def test_numbers_of_columns_in_the_first_row_are_no_sample(tmp_path: Path) -> None:
    text = ",".join(map(str, range(PULSES))) + "\n" + "".join(",".join(map(str, row)) + "\n" for row in RF.T)
    recording = read(tmp_path / "a.csv", text, sample_rate_hz=40e6, axes="sample,pulse")
    np.testing.assert_array_equal(recording.values[0, 0], RF)


def test_a_transposed_table_is_read_by_columns(tmp_path: Path) -> None:
    table = np.loadtxt(rows().splitlines(), delimiter=",").T
    text = "".join(",".join(f"{value:.9g}" for value in row) + "\n" for row in table)
    recording = read(tmp_path / "a.csv", text, transpose=True)
    np.testing.assert_array_equal(recording.values[0, 0], RF)


def test_records_that_begin_between_samples_are_shifted_to_one_time(tmp_path: Path) -> None:
    # A tone of 4 periods in the record: the shift of a periodic signal is exact.
    late = np.array([0.0, 0.3, -0.45, 0.1, 0.2, -0.3, 0.0, 0.4, 0.25])
    tone = np.cos(2 * np.pi * 4 / SAMPLES * (np.arange(SAMPLES) + late[:, None]))
    lines = [f"{(k + late[p]) * INTERVAL_S:.12e},{tone[p, k]:.12f}\n" for p in range(PULSES) for k in range(SAMPLES)]
    recording = read(tmp_path / "a.csv", "time_s,volt\n" + "".join(lines))
    np.testing.assert_allclose(recording.values[0, 0], np.tile(tone[0], (PULSES, 1)), atol=1e-9)
    assert any("records begin up to 0.45 samples apart" in text for text in recording.inferred)


def test_complex_numbers_are_i_and_q(tmp_path: Path) -> None:
    values = RF + 1j * RF[::-1]
    text = "".join(",".join(f"{v.real}{v.imag:+}i" for v in row) + "\n" for row in values)
    recording = read(
        tmp_path / "a.csv", text, sample_rate_hz=10e6, demodulation_hz=5e6, axes="pulse,sample", samples=[0, 32]
    )
    assert "I and Q are mixed up by 5e+06 Hz" in " ".join(recording.inferred)


MALFORMED: Mapping[str, tuple[str | bytes, Mapping[str, Any], str]] = {
    "no numbers": ("a,b\nc,d\n", {}, "no line of numbers"),
    "word among numbers": (rows().replace(f"{RF[3, 20]:.6f}", "four"), {}, "line 21 has values that are not numbers"),
    "cut in a line": (rows()[:-70], {}, "line 32 has"),
    "cut in a number": (rows("\t")[:-40], {}, "line 32 has"),
    "empty cell": (rows().replace(f"{RF[3, 20]:.6f}", ""), {}, "line 21 has values that are not numbers"),
    "excess cell": (rows().replace(f"{RF[3, 20]:.6f}", "1,2"), {}, "line 21 has 11 values, earlier lines 10"),
    "segments absent": (
        f"Segments,9,SegmentSize,32\nSegment,TrigTime,TimeSinceSegment1\n{SEGMENTS}Time,Ampl\n{STACKED[:1000]}".rsplit(
            "\n", 1
        )[0],
        {},
        "the header states 9 segments of 32 samples",
    ),
    "time without unit": (rows(first=lambda k: str(0.025 * k)), {}, "ascends by 0.025 and has no unit"),
    "uneven time": (rows(first=lambda k: str(k * 1e-8 + (k > 20) * 1e-6)), {}, "column 1 ascends unevenly"),
    "one record": (
        "".join(STACKED.splitlines(keepends=True)[:SAMPLES]),
        {},
        "a signal of 32 samples has no axis pulse",
    ),
    "decimal comma and comma": (rows(",", ",").replace("e-0", "e-"), {}, "commas may separate numbers"),
    "unknown encoding": (rows(), {"encoding": "utf-17"}, "encoding 'utf-17' is not known"),
    "wrong encoding": (
        "t (µs),a\n".encode("latin-1") + rows().encode(),
        {"encoding": "utf-8"},
        "no utf-8 text (byte 4)",
    ),
    "utf-16 without mark": (rows().encode("utf-16-le"), {}, "bytes of value 0"),
    "binary": (bytes(range(1, 256)) * 3, {}, "control characters"),
    "columns beyond": (rows(), {"columns": "2-99"}, "names none of the 10 columns"),
    "columns of words": (rows(), {"columns": "volt"}, "names none of the 10 columns"),
    "columns backwards": (rows(), {"columns": "5-2"}, "names none of the 10 columns"),
    "all skipped": (rows(), {"skip_rows": 1000}, "no line of numbers"),
    "wrong delimiter": (rows(), {"delimiter": ";"}, "no line of numbers"),
    "wrong decimal": (rows(), {"decimal": ","}, "no line of numbers"),
    "decimal of two": (rows(), {"decimal": ".,"}, "is not one of the choices"),
    "row absent": (rows().replace(rows().splitlines(keepends=True)[12], ""), {}, "column 1 ascends unevenly"),
    "row twice": (rows() + rows().splitlines()[-1], {}, "column 1 ascends unevenly"),
    "first row spoilt": ("time_s\n" + rows().replace("e-07", "e--7", 1), {}, "line 2 has values that are not numbers"),
    "columns of two units": (f"t (s),CH1 (mV){',CH2 (V)' * 8}\n{rows()}", {}, "different units (CH1 (mV), CH2 (V))"),
    "end absent": (
        "Record Length,64\nTIME" + NAMES + "\n" + rows(),
        {},
        "the header states 64 samples, 32 rows follow",
    ),
    "complex number among real ones": (rows().replace(f"{RF[3, 20]:.6f}", "1+2j"), {}, "line 21 has values that"),
    "records too far apart": (
        "".join(f"{(k + 5 * p) * INTERVAL_S:.6e},{RF[p, k]}\n" for p in range(PULSES) for k in range(SAMPLES)),
        {},
        "records begin up to 40 samples apart",
    ),
    "record length that does not divide": (
        "time_s,v\n" + "".join(f"{k * INTERVAL_S:.6e},{RF.flat[k]}\n" for k in range(PULSES * SAMPLES)),
        {"record_samples": 100},
        "is not several records of 100 samples",
    ),
}


@pytest.mark.parametrize("case", MALFORMED)
def test_a_malformed_text_is_refused_with_one_clear_message(case: str, tmp_path: Path) -> None:
    content, options, said = MALFORMED[case]
    with pytest.raises(SettingsError) as refused:
        read(tmp_path / "a.csv", content, **options)
    text = str(refused.value)
    assert said in text
    assert "Try: " in text


def test_a_changed_file_is_read_or_refused_but_never_fails_otherwise(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    messages = []
    for content in LAYOUTS.values():
        whole = content if isinstance(content, bytes) else content.encode()
        for _ in range(6):
            first, count = int(rng.integers(len(whole))), int(rng.integers(0, 30))
            changed = whole[:first] + bytes(rng.integers(0, 256, 3).astype(np.uint8)) + whole[first + count :]
            try:
                read(tmp_path / "a.csv", changed)
            except SettingsError as error:
                messages.append(str(error))
    assert len(messages) > 3 * len(LAYOUTS)
    assert all("Try: " in message for message in messages)


@pytest.mark.parametrize("header", ["Length: 0.5 m", "Length: 15 mm", "nt = 0", "Record Length,1e999"])
def test_a_header_that_states_no_length_of_a_record_is_ignored(header: str, tmp_path: Path) -> None:
    recording = read(tmp_path / "a.csv", f"{header}\n{rows()}")
    np.testing.assert_array_equal(recording.values[0, 0], RF)


def test_a_delimiter_may_have_several_characters(tmp_path: Path) -> None:
    recording = read(tmp_path / "a.txt", rows(), delimiter=",")
    again = read(tmp_path / "b.txt", rows("::"), delimiter="::")
    np.testing.assert_array_equal(again.values, recording.values)
