"""What of a twin contradicts its scene is named, with both numbers and the remedy."""

import pytest

from hpe_rig.measurement.setup import prepare, prepare_text
from hpe_rig.plan import check_plan, plan_text
from hpe_rig.plan.checks.simulation import simulation
from hpe_rig.scene import load_scene, shipped_scenes

TABLE_1 = shipped_scenes()["table-1"]


def found(text, check):
    setup = prepare_text("a", text, refuse=False)
    return [each for each in setup.findings if each.check == check]


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in ("bovine-muscle", "gelatin-8", "table-1") else pytest.mark.slow)
        for name in shipped_scenes()
    ],
)
def test_shipped_scenes_agree_with_their_twins(name):
    said = {each.check for each in prepare(name, refuse=False).findings}
    assert not said & {"gate in focus", "sound speed", "motion aliased", "declared"}


def test_a_gate_in_which_nothing_echoes_is_refused():
    (finding,) = found(TABLE_1.replace("gate_depth_m = 70.0e-3", "gate_depth_m = 60.0e-3"), "gate in focus")
    assert finding.level == "refused"
    for word in ("60 mm", "0.07 m", "2.5 mm from the focus", "equal depths"):
        assert word in str(finding)


@pytest.mark.parametrize(("depth_m", "level"), [(70.4e-3, None), (70.6e-3, "warning"), (73e-3, "warning")])
def test_a_gate_beside_the_focus_is_named(depth_m, level):
    each = found(TABLE_1.replace("gate_depth_m = 70.0e-3", f"gate_depth_m = {depth_m}"), "gate in focus")
    assert [finding.level for finding in each] == ([] if level is None else [level])


@pytest.mark.parametrize(
    ("setting", "value", "words"),
    [
        ("simulation.beams.tracking_width_m", [0.1e-3, 0.078e-3, 0.83e-3], "beams.tracking_width_m = [7.8e-05, "),
        ("simulation.beams.excitation_width_m", [0.2e-3, 0.2e-3, 1.8e-3], "simulates [0.0002, 0.0002, 0.0018]"),
        ("medium.shear_modulus_pa", 3e3, "medium.shear_modulus_pa = 3000, the twin simulates 1.2e+04"),
        ("simulation.specimen.medium", "zener", "medium = voigt, the twin simulates zener"),
    ],
)
def test_beams_and_medium_of_another_bench_than_the_twins_are_named(setting, value, words):
    medium = {
        "medium.shear_modulus_pa": 12e3,
        "medium.shear_viscosity_pa_s": 5.7,
        "medium.density_kg_per_m3": 1060.0,
    }
    scene = load_scene("bovine-muscle")
    assert not [each for each in prepare(scene.with_(medium)).findings if each.check == "declared"]
    (finding,) = [each for each in prepare(scene.with_(medium | {setting: value})).findings if each.check == "declared"]
    assert finding.level == "warning"
    assert words in finding.text


def test_a_motion_wider_than_declared_is_named():
    scene = load_scene("table-1").with_({"simulation.beams.width_ratio": [2.0, 2.0, 2.0]})
    (finding,) = [each for each in prepare(scene).findings if each.check == "declared"]
    assert "simulates [0.000156, 0.000156, 0.00166]" in finding.text


def test_a_focus_that_is_declared_elsewhere_than_the_twins_is_named():
    scene = load_scene("bovine-muscle").with_({"beams.focus_depth_m": 69e-3, "simulation.beams.focus_depth_m": 70e-3})
    (finding,) = [each for each in prepare(scene).findings if each.check == "declared"]
    assert "beams.focus_depth_m = 0.069, the twin simulates 0.07" in finding.text


def test_a_push_that_was_scanned_is_no_force_that_a_fit_knows():
    setup = prepare("bovine-muscle-aperture")
    keys = {"simulation.beams.field": "measured", "simulation.beams.excitation_scan": "push.h5"}
    scene = setup.scene.scene.with_(keys | {"simulation.beams.tracking_scan": "tracking.h5"})
    (finding,) = [each for each in simulation(scene, setup.bench.bench, setup.plan) if each.check == "declared"]
    assert finding.level == "warning"
    assert "assume an even bowl of 45 mm instead" in finding.text
    assert "beams.excitation_scan" in finding.remedy
    told = scene.with_({"beams.excitation_scan": "push.h5"})
    assert not [each for each in simulation(told, setup.bench.bench, setup.plan) if each.check == "declared"]
    other = scene.with_({"beams.excitation_scan": "other.h5"})
    (finding,) = [each for each in simulation(other, setup.bench.bench, setup.plan) if each.check == "declared"]
    assert "other.h5, the twin simulates push.h5" in finding.text


def test_another_sound_speed_moves_the_gate_as_well():
    text = TABLE_1.replace("[simulation]\n", "[simulation]\nsound_speed_m_per_s = 1580.0\n")
    assert [each.level for each in found(text, "sound speed")] == ["warning"]
    (finding,) = found(text, "gate in focus")
    assert "71.82 mm" in finding.text  # 70 mm x 1580 / 1540


@pytest.mark.parametrize(
    ("latency", "depth_mm"), [("digitizer_latency_s", "70.77"), ("aux_latency_s", "69.23")], ids=["later", "sooner"]
)
def test_a_record_that_begins_later_after_its_pulse_than_planned_looks_deeper(latency, depth_mm):
    """A digitizer that is late looks deeper, a trigger output that is late fires the pulse later: 1 us is 0.77 mm."""
    setup = prepare("table-1")
    planned_s = getattr(setup.bench.bench.digitizer, {"digitizer_latency_s": "latency_s"}.get(latency, latency))
    scene = setup.scene.scene.with_({f"simulation.instruments.{latency}": planned_s + 1e-6})
    (finding,) = [each for each in prepare(scene, refuse=False).findings if each.check == "gate in focus"]
    assert f"the gate's centre is {depth_mm} mm deep" in finding.text


@pytest.mark.parametrize(("moving_hz", "seen"), [(3800.0, "to 200 Hz"), (4200.0, "to 200 Hz"), (215.0, "at 215 Hz")])
def test_motion_that_the_pulses_show_at_a_wanted_frequency_is_named(moving_hz, seen):
    extra = f"\n[[simulation.motion]]\nfrequency_hz = {moving_hz}\namplitude_m = 1e-6\n"
    (finding,) = found(TABLE_1 + extra, "motion aliased")
    assert finding.level == "warning"
    assert seen in finding.text


def test_motion_of_no_amplitude_is_not_named():
    assert not found(TABLE_1 + "\n[[simulation.motion]]\nfrequency_hz = 215.0\namplitude_m = 0.0\n", "motion aliased")


@pytest.mark.parametrize("moving_hz", [1.2, 400.0, 3000.0])
def test_motion_that_the_pulses_tell_apart_is_not(moving_hz):
    extra = f"\n[[simulation.motion]]\nfrequency_hz = {moving_hz}\namplitude_m = 1e-6\n"
    assert not found(TABLE_1 + extra, "motion aliased")


def test_too_fast_a_motion_names_a_force_that_passes():
    text = shipped_scenes()["gelatin-15"]
    force = next(line for line in text.splitlines() if line.startswith("force_density_n_per_m3"))
    (finding,) = found(text.replace(force, "force_density_n_per_m3 = 5.0e8"), "motion between pulses")
    key, _, value = finding.remedy.partition(",")[0].rpartition(" = ")
    assert key == "simulation.specimen.force_density_n_per_m3"
    assert not found(text.replace(force, f"force_density_n_per_m3 = {value}"), "motion between pulses")


def test_the_motion_of_a_measured_run_is_not_computed_again():
    text = shipped_scenes()["gelatin-15"]
    force = next(line for line in text.splitlines() if line.startswith("force_density_n_per_m3"))
    setup = prepare_text("moving", text.replace(force, "force_density_n_per_m3 = 5.0e8"), refuse=False)
    findings = {
        measured: check_plan(setup.scene.scene, setup.bench.bench, setup.plan, measured) for measured in (False, True)
    }
    assert [finding.check for finding in findings[False] if finding not in findings[True]] == ["motion between pulses"]


def test_delays_that_are_all_disturbed_are_a_refusal_unless_disturbed_pulses_are_skipped():
    text = shipped_scenes()["gelatin-15"]
    rate = next(line for line in text.splitlines() if line.startswith("pulse_rate_hz"))
    for skip, words in (("", "none: at any delay"), ('\ndisturbed = "skip"', ", which are skipped")):
        lines = text.replace(rate, f"pulse_rate_hz = 3990.0{skip}").splitlines()
        scene = "\n".join(line for line in lines if not line.startswith("disturbed") or line in skip)
        setup = prepare_text("a", scene, refuse=False)
        assert words in plan_text("a", setup.plan, setup.findings)
