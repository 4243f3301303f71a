"""The detection floor and the dose, against the figures of docs/explanation/prediction.md."""

import numpy as np
import pytest

from hpe_rig.bench import twin_of
from hpe_rig.measurement.setup import prepare, prepare_text
from hpe_rig.prediction.detection import FALSE_ALARMS, amplitude_quantile, detection_floor
from hpe_rig.prediction.output_text import calibration_text, extrapolation_text
from hpe_rig.prediction.text import detection_text
from hpe_rig.scene import parse_scene, shipped_scenes

SCENES = shipped_scenes()
WITH_SPECIMEN = [name for name, text in SCENES.items() if "[simulation.specimen]" in text]


def scene(name, *edits):
    text = SCENES[name]
    for old, new in edits:
        assert old in text
        text = text.replace(old, new)
    return parse_scene(name, text).scene


def test_noise_of_the_default_conditions_is_that_of_the_theory_page():
    """100 pulses at 40 dB, 1.67 nm; half a unit of its last digit, and 0.4 % of gate samples."""
    assert detection_floor(scene("table-1")).noise_m == pytest.approx(1.67e-9, abs=0.012e-9)


def test_trigger_jitter_of_a_nanosecond_is_that_of_the_theory_page():
    """0.77 um a pulse; over 400 pulses with a Hann window about 65 nm."""
    hann = scene("muscle-force", ("[processing]", '[processing]\nestimator = "cross_spectrum"'))
    assert detection_floor(hann).trigger_jitter_m == pytest.approx(65e-9, rel=0.03)
    assert detection_floor(scene("muscle-force")).trigger_jitter_m == pytest.approx(
        0.77e-6 * np.sqrt(2 / 400), rel=1e-9
    )
    assert detection_floor(scene("muscle-force"), simulated=False).trigger_jitter_m == 0.0


def test_noise_exceeds_the_floor_once_in_twenty():
    found = detection_floor(scene("muscle-force"))
    normal = np.random.default_rng(1).standard_normal((2, 40_000)) * found.quadrature_m
    share = np.mean(np.hypot(*normal) > found.detected_m)
    # Three standard deviations of a binomial share of 1/20 in 40000.
    assert share == pytest.approx(0.05, abs=3 * np.sqrt(0.05 * 0.95 / 40_000))


@pytest.mark.parametrize(
    ("larger", "closed_form"), [(1.0, np.sqrt(2 * np.log(20))), (np.sqrt(2), np.sqrt(2) * 1.959964)]
)
def test_the_quantile_is_rayleighs_for_equal_quadratures_and_normal_for_a_single_one(larger, closed_form):
    assert amplitude_quantile(larger) == pytest.approx(closed_form, rel=1e-6)


@pytest.mark.parametrize("larger", [1.1, 1.3, 1.41])
def test_the_quantile_of_unequal_quadratures_is_exceeded_once_in_twenty(larger):
    deviations = np.array([larger, np.sqrt(2 - larger**2)])
    amplitude = np.hypot(*(np.random.default_rng(2).standard_normal((40_000, 2)) * deviations).T)
    # Three standard deviations of a binomial share of 1/20 in 40000.
    tolerance = 3 * np.sqrt(FALSE_ALARMS * (1 - FALSE_ALARMS) / 40_000)
    assert np.mean(amplitude > amplitude_quantile(larger)) == pytest.approx(FALSE_ALARMS, abs=tolerance)


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=() if name in WITH_SPECIMEN[:3] else pytest.mark.slow) for name in WITH_SPECIMEN],
)
def test_every_scene_with_a_specimen_prints_its_dose(name):
    lines = list(detection_text(scene(name)))
    lengths = scene(name).excitation.burst_length_s
    assert lines[0].startswith("detection floor")
    # Of a sphere no intensity is known: its force is that on a surface.
    lengths = () if "simulation.specimen.sphere" in SCENES[name] else lengths
    # and that it pushes too hard for linear propagation, where it does
    doses = lines[1 : 1 + len(lengths)]
    assert [line.partition(":")[0] for line in lines[1 + len(lengths) :]] in ([], ["propagation"])
    for line, length_s in zip(doses, lengths, strict=True):
        dose = twin_of(scene(name)).dose(scene(name).excitation, length_s, np.array([200.0]))
        moved = dose.displacement_limit_m[0]
        assert f"{moved * 1e9:.3g} nm at 200 Hz" in line
        # The bench of the paper cannot have stayed below the limit: its floor is far above what moves there. A gate on
        # something that stands still takes the jitter away.
        if "trigger_jitter_s" in SCENES[name]:
            still = "reference_gate_depth_m" in SCENES[name]
            assert bool(moved > 4 * detection_floor(scene(name)).detected_m) is still


def test_without_specimen_or_excitation_there_is_no_dose():
    assert len(list(detection_text(scene("table-1")))) == 1
    assert len(list(detection_text(scene("gelatin-8"), simulated=False))) == 1


def test_shifting_pulses_cost_noise_for_the_other_fitted_harmonics():
    """Where every period is sampled alike the columns are orthogonal and a quadrature has 2/N of a pulse's noise."""
    least_squares = "[processing]\n", '[processing]\nharmonic = "least_squares"\n'
    names = "bovine-muscle-synchronous", "bovine-muscle"
    alike, shifted = (prepare_text("a", SCENES[name].replace(*least_squares)) for name in names)
    plain = detection_floor(alike.scene.scene).noise_m
    assert detection_floor(alike.scene.scene, True, alike.plan.shots[0]).noise_m == pytest.approx(plain, rel=1e-6)
    with_prior = prepare_text("a", SCENES["bovine-muscle"])
    own_m, known_m = (
        detection_floor(each.scene.scene, True, each.plan.shots[0]).noise_m for each in (shifted, with_prior)
    )
    assert own_m > 1.4 * plain
    assert known_m < 1.2 * plain


def test_a_calibration_that_contradicts_the_twins_force_is_reported_with_both_intensities() -> None:
    setup = prepare("bovine-muscle")
    # The calibration of the shipped bench is assumed, which contradicts nothing.
    assert list(calibration_text(setup.scene.scene, setup.bench.bench)) == []
    calibration = setup.bench.bench.calibration
    assert calibration is not None
    bench = setup.bench.bench.model_copy(
        update={"calibration": calibration.model_copy(update={"source": "hydrophone"})}
    )
    (line,) = calibration_text(setup.scene.scene, bench)
    # 0.55 dB/cm/MHz is 19.00 Np/m at 3 MHz; 5.2 W/cm2 in water, derated by 6.3 dB.
    stands_for = 2.2e6 * 1540 / (2 * 18.997)
    ratio = stands_for / (5.2e4 * 10**-0.63)
    assert f"{stands_for * 1e-4:.3g} W/cm2, {ratio:.3g} times as much" in line
    specimen = {**setup.scene.scene.simulation["specimen"], "force_density_n_per_m3": 2.2e6 / ratio}
    agreeing = setup.scene.scene.model_copy(
        update={"simulation": {**setup.scene.scene.simulation, "specimen": specimen}}
    )
    assert list(calibration_text(agreeing, bench)) == []
    real = bench.model_copy(update={"simulated": False})
    assert list(calibration_text(setup.scene.scene, real)) == []


def calibrated(bench, amplitude_vpp, sppa_w_per_m2, simulated=False):
    """Return a bench whose toneburst was calibrated at another drive, to another intensity."""
    drive = bench.calibration.toneburst.model_copy(
        update={"amplitude_vpp": amplitude_vpp, "sppa_w_per_m2": sppa_w_per_m2}
    )
    calibration = bench.calibration.model_copy(update={"toneburst": drive})
    return bench.model_copy(update={"calibration": calibration, "simulated": simulated})


def test_an_output_scaled_from_another_drive_reports_the_change_by_shocks() -> None:
    setup = prepare("bovine-muscle")
    aperture = prepare("bovine-muscle-aperture").scene.scene
    scene, bench = setup.scene.scene, setup.bench.bench
    assert list(extrapolation_text(scene, bench)) == [], "at the calibrated drive itself nothing is scaled"
    (line,) = extrapolation_text(scene, calibrated(bench, 0.1, 5.2e4))
    assert line.endswith("from 0.1 to 1 Vpp. The effect of shocks is not known without beams.transducer_diameter_m")
    # z p 2 pi f beta / (rho c^3 sqrt(F_a)) of 0.46 MPa, 7 W/cm2, and of ten times as much pressure
    (up,) = extrapolation_text(aperture, calibrated(bench, 0.1, 7e4))
    assert "from 0.1 to 1 Vpp; at distortions of 0.018 and 0.18 at the focus (IEC 61949)" in up
    assert "I_sppa by up to +12 % and p- by up to -22 %" in up
    # scaled down from full drive it is the other way round
    weak = aperture.with_({"excitation.force_fraction": [0.01]})
    (down,) = extrapolation_text(weak, calibrated(bench, 1.0, 7e6 * 1.1245))
    assert "I_sppa by up to -11 % and p- by up to +29 %" in down
    # too weak for shocks: nothing worth a line
    assert list(extrapolation_text(aperture, calibrated(bench, 0.5, 1e3))) == []
    assert list(extrapolation_text(scene, calibrated(bench, 0.5, 1e3, simulated=True))) == []


def test_the_floor_of_an_estimator_that_reads_a_peak_states_an_upper_bound_of_false_alarms() -> None:
    by_peak = scene("table-1").with_({"processing.estimator": "cross_spectrum"})
    assert "(at most 5 % false alarms)" in next(detection_text(by_peak))
    assert "(5 % false alarms)" in next(detection_text(scene("table-1")))
