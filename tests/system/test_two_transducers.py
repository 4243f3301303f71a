"""A bench on which one transducer pushes and another one tracks: times, beams, the twin, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hpe_rig as hpe
from hpe_rig.bench import parse_bench, read_bench, twin_of, with_transducers
from hpe_rig.bench.bench_file import ForeignRecording
from hpe_rig.measurement import prepare
from hpe_rig.plan import disturbed_pulses
from hpe_rig.scene import SettingsError, shipped_scenes
from sim_backend.acoustics import Acoustics
from sim_backend.settings import SimulationSettings
from sim_backend.wiring import Bursts, Capture

PUSH_M, TRACKING_M, SOUND_SPEED_M_PER_S = 70e-3, 40e-3, 1540.0
LATER_S = (PUSH_M - TRACKING_M) / SOUND_SPEED_M_PER_S
TRANSDUCERS = """
[transducers.push]
focus_depth_m = 70e-3
width_m = [0.34e-3, 0.34e-3, 3.60e-3]

[transducers.tracking]
focus_depth_m = 40e-3
width_m = [0.078e-3, 0.078e-3, 0.83e-3]
pulse_length_m = 1.32e-3
"""
PULSER = 'source = "tracking_pulser.output"\ntarget = "{}transducer.drive"'


def bench_text() -> str:
    text = read_bench().text
    assert PULSER.format("") in text
    return text.replace(PULSER.format(""), PULSER.format("tracking_")) + TRANSDUCERS


def scene_text(beams: str = "") -> str:
    """Return a scene of one place without [beams] of its own, in focus of the tracking transducer."""
    text = shipped_scenes()["gelatin-moduli"]
    text = text[: text.index("[beams]")] + beams + text[text.index("[processing]") :]
    text = text.replace("lateral_offset_m = [1.0e-3, 2.25e-3, 3.5e-3, 4.75e-3, 6.0e-3]", "lateral_offset_m = [0.0]")
    return text.replace("gate_depth_m = 70.0e-3", "gate_depth_m = 40.0e-3").replace(
        "burst_count = 30", "burst_count = 20"
    )


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("two")
    (folder / "scene.toml").write_text(scene_text(), encoding="utf-8")
    (folder / "bench.toml").write_text(bench_text(), encoding="utf-8")
    return folder / "scene.toml", folder / "bench.toml"


def test_gates_count_from_the_transducer_that_tracks_and_phases_from_the_push(files: tuple[Path, Path]) -> None:
    setup = prepare(*files)
    [shot] = setup.plan.shots
    way_s = TRACKING_M / SOUND_SPEED_M_PER_S
    assert np.mean(shot.timeline.gate_offset_s) == pytest.approx(2 * way_s)
    assert shot.timeline.time_zero_s - shot.timeline.burst_onset_s[0] == pytest.approx(PUSH_M / SOUND_SPEED_M_PER_S)
    beams = setup.scene.scene.beams
    assert beams is not None
    assert beams.tracking_width_m == (0.078e-3, 0.078e-3, 0.83e-3)


def test_a_toneburst_disturbs_pulses_for_as_much_longer_as_it_travels(files: tuple[Path, Path], tmp_path: Path) -> None:
    near = bench_text().replace("focus_depth_m = 70e-3", "focus_depth_m = 40e-3")
    (tmp_path / "near.toml").write_text(near, encoding="utf-8")
    far, near_by = (prepare(files[0], bench).plan.shots[0] for bench in (files[1], tmp_path / "near.toml"))
    lost = disturbed_pulses(far).sum() - disturbed_pulses(near_by).sum()
    per_burst = LATER_S * 3990.0
    assert lost == pytest.approx(20 * per_burst, abs=2)


def test_the_twin_moves_and_echoes_when_the_plan_says(files: tuple[Path, Path], tmp_path: Path) -> None:
    """On the axis, where speckle turns no phase. From another time on, one of 1 kHz would be off by 0.12 rad."""
    run = hpe.measure(files[0], bench=files[1], path=tmp_path / "run.h5")
    [shot] = run.estimate().shots
    for each in shot.estimates:
        assert each.phase_error_rad is not None
        assert abs(each.phase_error_rad) < 4 * each.phase_uncertainty_rad
        assert each.phase_uncertainty_rad < 0.03
    fit = hpe.fit_moduli(run, laws=["voigt"]).best
    assert abs(fit.values["shear_modulus_pa"] - 7250) < 3 * fit.uncertainty["shear_modulus_pa"]
    again = hpe.open_run(tmp_path / "run.h5")
    assert again.scene.beams == run.scene.beams
    # In another gate the motion of the same shot, at about its phase: within a third of the force's width of 3.6 mm.
    [focus, *_] = shot.estimates
    beside = again.with_profile(0.5e-3).estimate().profile
    assert len({each.depth_m for each in beside}) > 1
    for each in beside:
        assert abs(each.depth_m - TRACKING_M) < 1.2e-3
        assert each.shot.estimates[0].tracked_phase_rad == pytest.approx(focus.tracked_phase_rad, abs=0.1)
    # Sound from a push 10 mm farther away arrives 6.5 us later, and phases count from there.
    swept = again.sweep({"beams.push_focus_depth_m": [PUSH_M, PUSH_M + 10e-3]})
    first, farther = (each.estimates[0] for each in swept.shots)
    turned_rad = 2 * np.pi * first.frequency_hz * 10e-3 / SOUND_SPEED_M_PER_S
    # Of 6.5 us; the pulses that echoes of such a push would disturb are left out besides, which turns by another 1 us.
    assert farther.tracked_phase_rad - first.tracked_phase_rad == pytest.approx(turned_rad, rel=0.25)


def test_the_echo_of_the_push_comes_the_way_of_both_transducers() -> None:
    """A point behind the focus, sound from one transducer and back to another; nothing of the plan's own takes part."""
    behind_m, onset_ps, length_ps, period_ps = 1e-3, 5_000_000, 10_000_000, 10_000
    point = {"kind": "point", "position_m": [0.0, 0.0, behind_m]}
    told = {
        "beams": {"focus_depth_m": PUSH_M, "tracking_focus_depth_m": TRACKING_M},
        "scatterers": {"per_cell": 0.0, "reflectors": [point]},
        "receiver": {"snr_db": None},
    }
    acoustics = Acoustics(SimulationSettings.model_validate(told))
    capture = Capture(0, 0, np.array([30_000_000]), period_ps, 8000)
    time_s = 1e-12 * (30_000_000 + period_ps * np.arange(8000))
    none = Bursts(*(np.zeros(0, np.int64),) * 2, *(np.zeros(0),) * 3)
    first, last = np.array([onset_ps]), np.array([onset_ps + length_ps])
    tonebursts = Bursts(first, last, np.array([3e6]), np.array([30.0]), np.array([1.0]))
    pulses = Bursts(first, first + 333_333, np.array([9e6]), np.array([3.0]), np.array([1.0]))
    of_push, of_pulse = (acoustics.record_volts(*each, capture)[0] for each in ((tonebursts, none), (none, pulses)))
    heard_s = time_s[np.abs(of_push) > 0.05 * np.abs(of_push).max()]
    begin_s = 5e-6 + (PUSH_M + TRACKING_M + 2 * behind_m) / SOUND_SPEED_M_PER_S
    # To the part of a carrier's period that a sine needs to rise, and a sample.
    assert heard_s[0] == pytest.approx(begin_s, abs=30e-9)
    assert heard_s[-1] == pytest.approx(begin_s + 10e-6, abs=30e-9)
    middle_s = time_s @ of_pulse**2 / (of_pulse @ of_pulse)
    assert middle_s == pytest.approx(5e-6 + 2 * (TRACKING_M + behind_m) / SOUND_SPEED_M_PER_S, abs=10e-9)


def test_what_a_push_puts_out_counts_from_the_transducer_that_pushes(files: tuple[Path, Path]) -> None:
    twin = twin_of(prepare(*files).scene.scene)
    assert twin is not None
    assert (twin.push_focus_depth_m, twin.focus_depth_m) == (PUSH_M, TRACKING_M)


def test_a_recording_that_was_taken_with_two_says_so_in_its_scene_alone(files: tuple[Path, Path]) -> None:
    bench = read_bench().bench
    scene = prepare(*files).scene.scene
    recording = ForeignRecording(source="rf.npy", sha256="0" * 64, format="npy", first_sample_s=0.0)
    imported = bench.model_copy(update={"recording": recording})
    assert with_transducers(scene, imported) is scene
    with pytest.raises(SettingsError, match="one transducer that pushes and tracks"):
        with_transducers(scene, bench)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (bench_text().replace(PULSER.format("tracking_"), PULSER.format("")), "drives the transducer that pushes"),
        (read_bench().text.replace(PULSER.format(""), PULSER.format("tracking_")), r"there is no \[transducers\]"),
        (bench_text().replace("width_m = [0.34e-3, 0.34e-3, 3.60e-3]", "width_m = [0.34e-3]"), "push.width_m"),
        (bench_text().replace("focus_depth_m = 40e-3", "focus_depth_m = -40e-3"), "tracking.focus_depth_m"),
        (bench_text()[: bench_text().index("[transducers.tracking]")], "transducers.tracking"),
    ],
)
def test_a_bench_whose_transducers_cannot_be_is_refused(text: str, said: str) -> None:
    with pytest.raises(SettingsError, match=said):
        parse_bench("bench", text)


@pytest.mark.parametrize(
    ("beams", "alone", "said"),
    [
        ("excitation_width_m = [0.5e-3, 0.5e-3, 3.60e-3]\n", False, "beams.excitation_width_m"),
        ("focus_depth_m = 41e-3\n", False, "beams.focus_depth_m"),
        ("focus_depth_m = 40e-3\npush_focus_depth_m = 70e-3\n", True, "one transducer that pushes and tracks"),
        ("push_focus_depth_m = 70e-3\n", True, "give both"),
    ],
)
def test_a_scene_that_says_otherwise_is_refused(
    beams: str, alone: bool, said: str, files: tuple[Path, Path], tmp_path: Path
) -> None:
    widths = {"excitation_width_m": "[0.34e-3, 0.34e-3, 3.60e-3]", "tracking_width_m": "[0.078e-3, 0.078e-3, 0.83e-3]"}
    rest = "".join(f"{key} = {value}\n" for key, value in widths.items() if key not in beams)
    (tmp_path / "scene.toml").write_text(scene_text(f"[beams]\n{beams}{rest}\n"), encoding="utf-8")
    with pytest.raises(SettingsError, match=said):
        prepare(tmp_path / "scene.toml", None if alone else files[1])
