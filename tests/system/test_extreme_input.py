"""Impossible or extreme scenes, numbers, paths and arguments are refused with a message."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import tomlkit
import typer
from typer.testing import CliRunner

from hpe_rig.bench import check_declared, read_bench
from hpe_rig.cli.app import app
from hpe_rig.cli.console import guarded, refuse_undecodable
from hpe_rig.measurement import prepare, prepare_text, record_run
from hpe_rig.plan import PlanError
from hpe_rig.runs import check, process
from hpe_rig.scene import SettingsError, load_scene, parse_toml, path_of, shipped_scenes, with_values
from hpe_rig.store import StoreError, read_run
from hpe_rig.study.definition import read_studies

MESSAGES = (StoreError, SettingsError, PlanError)
STUDY = """
title = "Two rates"
scene = "table-1"
[[axes]]
name = "f_prf"
unit = "Hz"
keys = {"tracking.pulse_rate_hz" = [2000.0, 4000.0]}
"""


def small_scene() -> str:
    """Return the text of a scene with few and short records."""
    text = shipped_scenes()["table-1"]
    for old, new in (
        ("pulse_count = 101", "pulse_count = 48"),
        ("[acquisition]", "[acquisition]\nrecord_samples = 256"),
    ):
        assert old in text, old
        text = text.replace(old, new)
    return text


@pytest.fixture(scope="module")
def small_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a small run file."""
    return record_run(prepare_text("small", small_scene()), tmp_path_factory.mktemp("run") / "run.h5")


DEEP_TABLE, LONG_NUMBER = f"x = {'[' * 5000}{']' * 5000}\n", f"x = {'9' * 5000}\n"
MUSCLE, TABLE_1 = "bovine-muscle", "table-1"
SPECIMEN, MOTION = "simulation.specimen", "simulation.motion[0]"
EXTREME_SCENES: Mapping[str, tuple[str, Mapping[str, Any], str]] = {
    "pulses at twice the burst rate": (MUSCLE, {"tracking.pulse_rate_hz": 200.0}, "no vibration frequency is wanted"),
    "pulses slower than bursts": (MUSCLE, {"tracking.pulse_rate_hz": 90.0}, "no vibration frequency is wanted"),
    "nothing to fit, by inaccurate clocks": (
        MUSCLE,
        {"tracking.pulse_rate_hz": 200.0, "processing.frequency_accuracy": 1e-5},
        "no vibration frequency is wanted",
    ),
    "attenuation of 60": (MUSCLE, {f"{SPECIMEN}.attenuation_db_per_cm_mhz": 60.0}, "at most 40 dB/cm/MHz"),
    "echoes lost on the way": (MUSCLE, {"simulation.scatterers.attenuation_db_per_cm_mhz": 40.0}, "400 dB leave no"),
    "force of 1e300": (MUSCLE, {f"{SPECIMEN}.force_density_n_per_m3": 1e300}, "at most 1e\\+10 N/m3"),
    "a force that moves too far": (MUSCLE, {f"{SPECIMEN}.force_density_n_per_m3": 1e10}, "ambiguous"),
    "vibration of 1e300 Hz": (TABLE_1, {f"{MOTION}.frequency_hz": 1e300}, "at most 1e\\+06 Hz"),
    "wanted frequency of 1e300 Hz": (TABLE_1, {"processing.frequencies_hz": [1e300]}, "at most 1e\\+06 Hz"),
    "burst rate of 1e300 Hz": (MUSCLE, {"excitation.burst_rate_hz": 1e300}, "at most 1e\\+09 Hz"),
    "bursts for ever": (MUSCLE, {"excitation.burst_rate_hz": 0.5}, "drive 20000 harmonics"),
    "SNR of 1e6 dB": (MUSCLE, {"simulation.receiver.snr_db": 1e6}, "at most 200 dB"),
    "SNR of -1e6 dB": (MUSCLE, {"simulation.receiver.snr_db": -1e6}, "at least -100 dB"),
    "noise without echo": (MUSCLE, {"simulation.receiver.snr_db": -40.0}, "below its noise"),
    "expected SNR of 1e6 dB": (MUSCLE, {"processing.expected_snr_db": 1e6}, "at most 200 dB"),
    "seed of 1e30": (MUSCLE, {"simulation.seed": 10**30}, "out of bounds"),
    "motion of 1e300 m": (TABLE_1, {f"{MOTION}.amplitude_m": 1e300}, "at most 1 m"),
    "motion of 1 mm": (TABLE_1, {f"{MOTION}.amplitude_m": 1e-3}, "a quarter wavelength"),
    "an echo of 1 uV": (TABLE_1, {"simulation.receiver.echo_rms_v": 1e-6}, "steps of the digitizer"),
    "jitter of half a period": (TABLE_1, {"simulation.instruments.trigger_jitter_s": 1e-7}, "phase is ambiguous"),
    "a box of 1 m3": (TABLE_1, {"simulation.scatterers.volume_m": [1.0, 1.0, 1.0]}, "scatterers, memory"),
    "1e12 scatterers a cell": (TABLE_1, {"simulation.scatterers.per_cell": 1e12}, "scatterers, memory"),
    "no scatterer": (TABLE_1, {"simulation.scatterers.per_cell": 0.0}, "nothing echoes"),
    "beams that do not meet": (TABLE_1, {"simulation.beams.lateral_offset_m": [1.0, 0.0]}, "do not meet"),
    "gate of 1e300 m": (TABLE_1, {"acquisition.gate_length_m": 1e300}, "at most 10 m"),
    "gate of a period": (TABLE_1, {"acquisition.gate_length_m": 0.09e-3}, "periods of tracking.carrier_hz"),
    "no sound speed": (TABLE_1, {"acquisition.sound_speed_m_per_s": 1e-300}, "at least 10 m/s"),
    "delay of 1e300 s": (MUSCLE, {"tracking.delay_s": 1e300}, "at most 1000 s"),
    "modulus of 1e300 Pa": (MUSCLE, {f"{SPECIMEN}.shear_modulus_pa": 1e300}, "at most 1e\\+12 Pa"),
    "viscosity of 1e300": (MUSCLE, {f"{SPECIMEN}.shear_viscosity_pa_s": 1e300}, "at most 1e\\+06 Pa s"),
    "a pulse of 1 um": (MUSCLE, {"beams.pulse_length_m": 1e-6}, "a single cycle"),
    "beams of no width": (MUSCLE, {"beams.excitation_width_m": [1e-300, 1e-300, 1e-300]}, "at least 1e-09 m"),
    "another board's memory": (
        TABLE_1,
        {"acquisition.record_samples": 2048, "simulation.instruments.samples_per_channel": 1024},
        "board holds 0 of 101 records",
    ),
    "messages that take no time": (MUSCLE, {"simulation.instruments.message_time_s": 0.0}, "at least 1e-06 s"),
    "a board that comes late": (TABLE_1, {"simulation.instruments.digitizer_latency_s": 1e-3}, "nothing echoes more"),
    "a train of ten years": (
        "cardiac-background",
        {"tracking.pulse_count": 344063, "tracking.pulse_rate_hz": 1e-3},
        "beyond the twin's clock of 106 days",
    ),
    "a push of waves of 3 um": (
        MUSCLE,
        {"acquisition.sound_speed_m_per_s": 10.0, "simulation.propagation.specimen_depth_m": 1e-9},
        "times the memory that a push may",
    ),
    "a force that is not a number": (MUSCLE, {"excitation.force_fraction": [float("nan")]}, "not finite"),
}


@pytest.mark.parametrize("case", EXTREME_SCENES)
def test_an_extreme_scene_is_refused_with_a_message(tmp_path: Path, case: str) -> None:
    name, changes, message = EXTREME_SCENES[case]
    tables = with_values(
        parse_toml(shipped_scenes()[name], name), {path_of(key): value for key, value in changes.items()}
    )
    path = tmp_path / "s.toml"
    path.write_text(tomlkit.dumps(tables), encoding="utf-8")
    try:
        checked = check(path)
    except MESSAGES as error:
        message_text = str(error)
    else:
        assert checked.refused
        message_text = str(checked)
    assert re.search(message, message_text), message_text
    assert "Try:" in message_text


def test_a_push_that_takes_minutes_is_announced_before_it_begins(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    import sim_backend.transducer as transducer

    monkeypatch.setattr(transducer, "push_of", lambda *_: None)
    scene = load_scene(MUSCLE).with_({"simulation.propagation": {"harmonics": 128}})
    assert not check_declared(scene)
    assert "with 128 harmonics takes minutes" in caplog.text


ENDLESS = [DEEP_TABLE, LONG_NUMBER, "x = 0x" + "f" * 5000 + "\n", "x = " + "{a=" * 3000 + "1" + "}" * 3000]


@pytest.mark.parametrize(
    ("source", "text"),
    [
        *(("scene", text) for text in ENDLESS),
        *((source, DEEP_TABLE) for source in ("bench", "study", "stored scene", "stored bench")),
    ],
    ids=range(8),
)
def test_endless_numbers_and_nesting_are_refused(small_run: Path, tmp_path: Path, source: str, text: str) -> None:
    path = tmp_path / "x.toml"
    bodies = {"scene": small_scene(), "bench": read_bench().text, "study": STUDY}
    path.write_text(text + bodies.get(source, ""), encoding="utf-8")
    reads: Mapping[str, Callable[[], object]] = {
        "scene": lambda: prepare(str(path)),
        "bench": lambda: prepare(TABLE_1, path),
        "study": lambda: read_studies(path),
    }
    read = reads.get(source)
    if read is None:
        run, name = tmp_path / "run.h5", source.split()[1]
        run.write_bytes(small_run.read_bytes())
        with h5py.File(run, "r+", libver=("v110", "v110")) as file:
            stored = text + file[name].asstr()[()]
            del file[name]
            file[name] = np.array(stored.encode(), dtype=h5py.string_dtype("utf-8", len(stored.encode())))
        read = partial(process, run)
    with pytest.raises(MESSAGES, match="Try:"):
        read()


@pytest.mark.skipif(os.name != "posix", reason="Windows has no such names and links")
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "s.toml", "--output", "a" * 300 + ".h5"], "cannot be written"),
        (["run", "s.toml", "--output", "a" * 251 + ".h5"], "cannot be written"),
        (["run", "s.toml", "--output", "file/x.h5"], "cannot be written"),
        (["run", "s.toml", "--output", "no/x.h5"], "cannot be written"),
        (["run", "s.toml", "--output", "stopped.h5"], "Try:"),
        (["run", "s.toml", "--output", "loop.h5"], "Try:"),
        (["run", "s.toml", "--bench", "loop.toml"], "cannot be read"),
        (["new", "\x00"], "cannot be written (embedded null byte)"),
        (["check", "loop.toml"], "cannot be read"),
        (["check", "s.toml", "--target", "1e-300"], "no length"),
        (["report", "a" * 300 + ".h5"], "Try:"),
        (["live", "a" * 300 + ".h5"], "Try:"),
        (["live", "file/x.h5"], "no run can be followed"),
        (["live", "no/x.h5"], "no run can be followed"),
        (["live", "loop.h5"], "no run can be followed"),
        (["accuracy", "motion", "--output", "folder.csv"], "cannot be written"),
        (["accuracy", "harmonic", "--figure", "file/x.svg"], "does not exist"),
        (["design", "s.toml", "--over", "pulse_rate_hz", "--seed", str(10**30)], "the seed is out of range"),
        (["design", "s.toml", "--over", "pulse_rate_hz", "--draws", str(10**12)], "take too long"),
        (["study", "fig-7", "--seed", str(10**30)], "out of bounds"),
        (["study", "fig-7", "--output", "file"], "cannot be written"),
        (["study", "endless.toml"], "points in all"),
    ],
)
def test_impossible_paths_and_numbers_are_refused_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "s.toml").write_text(small_scene(), encoding="utf-8")
    (tmp_path / "file").write_text("", encoding="utf-8")
    (tmp_path / "folder.csv").mkdir()
    (tmp_path / "stopped.h5.stop").mkdir()
    (tmp_path / "loop.toml").symlink_to("loop.toml")
    (tmp_path / "loop.h5").symlink_to("loop.h5")
    axes = "".join(f'[[axes]]\nname = "{n}"\nkeys = {{"{n}" = {{start = 1, stop = 2, count = 99999}}}}\n' for n in "ab")
    (tmp_path / "endless.toml").write_text(f'title = "x"\nscene = "table-1"\n{axes}', encoding="utf-8")
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 2
    assert isinstance(done.exception, SystemExit)
    assert message in done.output
    assert "Try:" in done.output


LONG_COMMENT = f"# {'x' * 1_000_000}\n"


@pytest.mark.parametrize("source", ["scene", "bench", "study"])
@pytest.mark.parametrize(
    ("text", "message"),
    [(LONG_COMMENT, "more than 1000000 bytes"), ("\n# \x9b2J\n", "line 2: the control character U+009B")],
)
def test_a_text_that_a_run_file_cannot_hold_is_refused_before_the_run(
    tmp_path: Path, source: str, text: str, message: str
) -> None:
    path = tmp_path / "x.toml"
    path.write_text(
        text + {"scene": small_scene(), "bench": read_bench().text, "study": STUDY}[source], encoding="utf-8"
    )
    reads: Mapping[str, Callable[[], object]] = {
        "scene": lambda: prepare(str(path)),
        "bench": lambda: prepare(TABLE_1, path),
        "study": lambda: read_studies(path),
    }
    with pytest.raises(SettingsError, match=re.escape(message)) as refused:
        reads[source]()
    assert "Try:" in str(refused.value)


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="POSIX")
def test_an_endless_file_is_refused_as_a_settings_file() -> None:
    for read in (prepare, lambda path: read_bench(Path(path)), read_studies):
        with pytest.raises(SettingsError, match="it has more than 1000000 bytes"):
            read("/dev/zero")


def test_texts_and_names_with_unusual_spaces_are_measured_and_read_again(tmp_path: Path) -> None:
    """Text copied from a web page may contain them. They are no reason to refuse a measurement."""
    unusual = "a\u00a0b\u200b\u202e\u2009"
    (scene := tmp_path / f"{unusual}.toml").write_text(f"# {unusual}\n{small_scene()}", encoding="utf-8")
    (bench := tmp_path / f"bench {unusual}.toml").write_text(f"# {unusual}\n{read_bench().text}", encoding="utf-8")
    run = record_run(prepare(str(scene), bench), tmp_path / f"{unusual}.h5")
    assert process(run).shots
    stored = read_run(run)
    assert stored.scene_toml.startswith(f"# {unusual}\n")
    assert stored.bench_toml.startswith(f"# {unusual}\n")
    # Printed names are escaped: one of the characters reverses the direction of a line.
    assert stored.scene_name.isprintable()
    assert stored.scene_name.startswith("a\\xa0b")


def test_an_argument_that_is_not_utf_8_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        refuse_undecodable(["hpe-rig", "check", os.fsdecode(b"\xff.toml")])
    assert ended.value.code == 2
    assert "no UTF-8 text. Try: rename" in capsys.readouterr().err


def test_an_unexpected_error_ends_in_one_message_and_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))

    @guarded
    def command() -> None:
        raise LookupError("unexpected")

    with pytest.raises(typer.Exit) as ended:
        command()
    assert ended.value.exit_code == 70
    (traceback,) = tmp_path.glob("hpe-rig-*.txt")
    assert "LookupError: unexpected" in traceback.read_text(encoding="utf-8")
