"""Beam averaging of scenes, against closed forms, quadratures and the twin's scatterers."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from hpe_rig.measurement.run import record_run
from hpe_rig.measurement.setup import prepare_text
from hpe_rig.prediction import beam_widths, predicted_averaging, resting_conditions, tracked_over_peak
from hpe_rig.prediction.beam_averaging import SHAPE_RELATIVE, averaging_ratio, axial_offset_factor, obliquity_factor
from hpe_rig.prediction.speckle import seeded_speckle
from hpe_rig.prediction.speckle_spread import region_spread, speckle_spread
from hpe_rig.prediction.text import averaging_text
from hpe_rig.result import Averaging
from hpe_rig.scene import SettingsError, load_scene, parse_scene, shipped_scenes
from sim_backend.echoes.exact_sums import running_sum
from sim_backend.echoes.pulse import hann_pulse
from sim_backend.echoes.scatterers import depth_delay_s, draw_field
from sim_backend.motion.field import field_transfer
from sim_backend.settings import Beams, Scatterers, SimulationSettings, Specimen
from sim_backend.transducer import push_intensity

FORCE_M = (0.17e-3, 0.17e-3, 1.80e-3)
TRACKING_M = (0.078e-3, 0.078e-3, 0.83e-3)
GATE_M, PULSE_M = 1.0e-3, 1.32e-3
FREQUENCY_HZ = np.array([100.0, 200.0, 400.0, 1000.0])
MUSCLE = shipped_scenes()["bovine-muscle"]
NARROW = MUSCLE.replace("[0.34e-3, 0.34e-3, 3.60e-3]", "[0.17e-3, 0.17e-3, 1.80e-3]")


def test_steepness_is_the_change_of_the_averaging_with_the_beams_area():
    """For the Gaussian motion and for the declared medium; central differences of 1e-3."""
    scene = parse_scene("a", MUSCLE + "\n[medium]\nshear_modulus_pa = 4e3\nshear_viscosity_pa_s = 1.0\n").scene
    beams = beam_widths(scene, "coherent")
    wider, narrower = (
        replace(beams, tracking_width_m=tuple(np.multiply(beams.tracking_width_m, [scale, scale, 1.0])))
        for scale in (1.001**0.5, 0.999**0.5)
    )
    area = (replace(each, depth_sd_m=0.0).gaussian_averaging() for each in (wider, narrower))
    assert beams.gaussian_steepness() == pytest.approx(np.log(next(area) / next(area)) / 2e-3, rel=1e-5)
    ratios = (averaging_ratio(scene, each, FREQUENCY_HZ)[0] for each in (wider, narrower))
    change = np.log(next(ratios) / next(ratios)) / 2e-3
    steepness = averaging_ratio(scene, beams, FREQUENCY_HZ)[2]
    assert steepness == pytest.approx(change, rel=1e-5)


def test_a_declared_medium_has_no_uncertainty_and_an_unknown_one_that_of_the_ensemble():
    """The twin's medium lies within two standard deviations of the ensemble."""
    text = "\n[medium]\nshear_modulus_pa = {}\nshear_viscosity_pa_s = {}\n"
    unknown = predicted_averaging(parse_scene("a", MUSCLE).scene, "coherent")
    soft, own = (
        predicted_averaging(parse_scene("a", MUSCLE + text.format(*medium)).scene, "coherent")
        for medium in (("1e3", "1.0"), ("12e3", "5.7"))
    )
    for item, true in zip(unknown, own, strict=True):
        assert (true.factor_uncertainty, true.phase_uncertainty_rad) == (0.0, 0.0)
        assert 0 < abs(item.factor - true.factor) < 2 * item.factor_uncertainty < 0.1
        assert 0 < abs(item.phase_rad - true.phase_rad) < 2 * item.phase_uncertainty_rad < 0.1
    factors = [[item.factor for item in each] for each in (own, soft)]
    assert factors[0][-1] < factors[0][0]
    assert factors[1][-1] < factors[0][-1]
    assert "0.970 for the Gaussian motion of eq. (12)" in "".join(averaging_text(parse_scene("a", MUSCLE).scene))


def test_without_tonebursts_the_motion_is_the_gaussian():
    each = predicted_averaging(parse_scene("a", shipped_scenes()["table-1"]).scene, "coherent")
    # 500 seeds of the scene on the twin: 0.8873 +- 0.0026
    assert [item.factor for item in each] == pytest.approx([0.887] * len(each), abs=5e-4)
    assert {item.factor_uncertainty for item in each} == {0.0}


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "excitation_width_m = [0.34e-3,",
            "excitation_width_m = [0.40e-3,",
            ["a round force", "0.0004 m by 0.00034 m"],
        ),
        (
            "[simulation.receiver]",
            "[simulation.beams]\nwidth_ratio = [1.0, 1.0, 1.0]\n[simulation.receiver]",
            ["width_ratio"],
        ),
    ],
)
def test_field_that_the_beams_do_not_allow_is_refused_with_a_remedy(tmp_path, old, new, words):
    assert old in MUSCLE
    with pytest.raises(SettingsError) as refused:
        record_run(prepare_text("a", MUSCLE.replace(old, new)), tmp_path / "a.h5")
    for word in [*words, 'specimen.field = "gaussian"']:
        assert word in str(refused.value)


@pytest.mark.slow
def test_twins_scatterers_are_tracked_as_predicted():
    """The whole gate's phase over draws of scatterers that the medium's field moves by 5 nm, 200 Hz."""
    specimen, draws, reach_m = Specimen(shear_modulus_pa=9e3, shear_viscosity_pa_s=2.0), 800, 5e-9
    pulse, gate_s = hann_pulse(9e6, 0.065), (np.arange(130) - 64.5) * 1e-8
    across_m, along_m = np.linspace(0, 0.72e-3, 37), np.linspace(0, 2.6e-3, 27)
    grid = field_transfer(specimen, FORCE_M, across_m, along_m, np.array([200.0]))[0]
    grid = grid / grid[0, 0]
    rng, tracked = np.random.default_rng(11), []
    for _ in range(draws):
        places = draw_field(Scatterers(), Beams(), rng)
        rest_s = depth_delay_s(places, "two_way", 1540.0)
        row = np.hypot(*places.offset_m[:, :2].T) / across_m[1]
        column = np.abs(places.offset_m[:, 2]) / along_m[1]
        i, j = row.astype(int), column.astype(int)
        a, b = row - i, column - j
        moved = (1 - a) * ((1 - b) * grid[i, j] + b * grid[i, j + 1])
        moved += a * ((1 - b) * grid[i + 1, j] + b * grid[i + 1, j + 1])
        delay_s = rest_s + 2 / 1540.0 * reach_m * np.stack([0 * rest_s, moved.real, moved.imag, 1 + 0 * rest_s])
        spectrum = np.fft.rfft(running_sum(delay_s, places.tracking_weight, pulse, gate_s))
        turn = np.angle(np.sum(np.conj(spectrum[1:]) * spectrum[0], axis=1))
        # Against an even motion: which frequency the echo has is the estimator's affair.
        tracked.append(complex(*turn[:2]) / turn[2])
    medium = "[medium]\nshear_modulus_pa = 9e3\nshear_viscosity_pa_s = 2.0\n"
    text = NARROW.split("[simulation]")[0].replace("[processing]", medium + "[processing]\nfrequencies_hz = [200.0]")
    predicted = predicted_averaging(parse_scene("a", text).scene, "coherent")[0]
    assert predicted is not None
    size = np.abs(tracked)
    error = predicted.speckle_relative / np.sqrt(draws)
    # Three standard errors, and as much of the loss as the correction for few speckles, a fortieth, may itself be off.
    assert size.mean() == pytest.approx(predicted.factor, abs=3 * error + 0.025 * (1 - predicted.factor))
    assert np.angle(np.mean(tracked)) == pytest.approx(predicted.phase_rad, abs=3 * error)
    # The spread's heavy tail, speckle's dark spots, makes it known to 2/sqrt(draws) at best: three of them.
    assert size.std() == pytest.approx(predicted.speckle_relative, rel=6 / np.sqrt(draws) + 0.1)
    assert np.angle(tracked).std() == pytest.approx(predicted.speckle_phase_rad, rel=6 / np.sqrt(draws) + 0.1)


def test_a_declared_focus_corrects_for_the_offset_and_adds_the_depths_uncertainty() -> None:
    scene = load_scene("table-1")
    (at_focus,) = predicted_averaging(scene, "coherent")
    (off,) = predicted_averaging(scene.with_({"beams.focus_depth_m": 71.0e-3}), "coherent")
    assert at_focus is not None
    assert off is not None
    assert at_focus.offset_relative == 0
    factor, spread = axial_offset_factor(-1.0e-3, 0.005 * 70.0e-3, 1.8e-3)
    assert (off.factor / at_focus.factor, off.offset_relative) == pytest.approx((factor, spread))


@pytest.mark.parametrize(("estimator", "expected"), [("coherent", 0.060 / 0.887), ("cross_spectrum", 0.080 / 0.893)])
def test_speckle_spread_predicts_the_monte_carlo_spreads(estimator: str, expected: float) -> None:
    resting = resting_conditions(load_scene("table-1"))
    assert resting is not None
    # both are heavy-tailed: 2 / sqrt(2000) on either side give 6.3 %; three of these
    spread, carrier = speckle_spread(resting, estimator)
    assert (spread, carrier) == (pytest.approx(expected, rel=0.19), 0.0)


def test_a_gate_holding_many_speckles_spreads_less() -> None:
    resting = resting_conditions(load_scene("table-1"))
    assert resting is not None
    thin = replace(
        resting,
        excitation_width_m=(0.17e-3, 0.17e-3, 1e3),
        tracking_width_m=(*resting.tracking_width_m[:2], 1e3),
        pulse_length_m=0.3e-3,
    )
    short, long = (speckle_spread(replace(thin, gate_length_m=gate_m), "coherent")[0] for gate_m in (1e-3, 4e-3))
    # four times the speckles, a little less for the pulse that overlaps the ends of the gate
    assert long == pytest.approx(short / 2, rel=0.15)


def test_an_estimator_by_the_carrier_has_the_spread_of_the_echo_s_frequency() -> None:
    table_one = load_scene("table-1")
    (by_carrier,), (by_echo,) = (predicted_averaging(table_one, each) for each in ("kasai", "loupas"))
    assert by_carrier is not None
    assert by_echo is not None
    assert by_carrier.speckle_relative == by_echo.speckle_relative
    # 500 seeds of the scene on the twin: kasai over coherent is 1.6 to 2.0 %
    assert by_carrier.carrier_relative == pytest.approx(0.018, abs=0.002)
    assert by_echo.carrier_relative == 0


def drawn_echoes(gate_m: float, draws: int = 4000) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Return echoes (draw, instant) of speckle in a gate at the focus, and the same weighted by squared depth."""
    random, fine_m = np.random.default_rng(2), 0.01e-3
    position_m, instant_m = (np.arange(-half, half, fine_m) for half in ((gate_m + PULSE_M) / 2, gate_m / 2))
    strength = random.standard_normal((draws, position_m.size)) + 1j * random.standard_normal((draws, position_m.size))
    strength = strength * np.exp(-(position_m**2) / (2 * TRACKING_M[2] ** 2))
    distance_m = instant_m[:, None] - position_m
    pulse = np.where(np.abs(distance_m) < PULSE_M / 2, np.cos(np.pi * distance_m / PULSE_M) ** 2, 0.0).T
    return strength @ pulse, (strength * position_m**2) @ pulse


def test_the_gate_s_ends_add_no_spread() -> None:
    resting = resting_conditions(load_scene("bovine-muscle"))
    assert resting is not None
    rigid = tracked_over_peak(resting, "coherent", seeded_speckle(resting, 200, lambda place: np.ones(place.shape[1])))
    np.testing.assert_allclose(rigid, 1.0, rtol=1e-12)
    # a motion that changes along the axis alone, by a part of what the ends would cut
    by_depth = tracked_over_peak(resting, "coherent", seeded_speckle(resting, 2000, lambda place: place[2] ** 2 / 1e-6))
    echo, weighted = drawn_echoes(GATE_M)
    expected = np.sum(np.conj(echo) * weighted, axis=1).real / np.sum(np.abs(echo) ** 2, axis=1) / 1e-6
    # 2000 and 4000 draws of kurtosis 6: 2.5 and 1.8 % of the standard deviation, three of both
    assert by_depth.std() == pytest.approx(expected.std(), rel=0.09)


def test_speckle_changes_the_phase_if_the_lag_varies_over_the_beam() -> None:
    def of_medium(modulus_pa: float, viscosity_pa_s: float) -> list[Averaging]:
        medium = f"\n[medium]\nshear_modulus_pa = {modulus_pa}\nshear_viscosity_pa_s = {viscosity_pa_s}\n"
        each = predicted_averaging(parse_scene("a", NARROW + medium).scene, "coherent")
        return [each[0], each[-1]]  # type: ignore[list-item]

    muscle, still = of_medium(9e3, 2.0), of_medium(9e7, 1e-3)
    # In a nearly elastic, quasi-static medium all of it lies along the motion but for what is radiated, as f over the
    # square root of the modulus: 1.26 % at 1 kHz in 90 MPa. A wave that lags turns with speckle.
    assert max(each.speckle_phase_rad for each in still) < 1.3e-2 * min(each.speckle_relative for each in still)
    turned = [each.speckle_phase_rad for each in muscle]
    assert turned[1] > 3 * turned[0] > 30 * still[0].speckle_phase_rad
    # Against 3000 draws of the twin's scatterers, moved by its own field: 1.28 and 1.86 % of amplitude, 0.093 and
    # 0.487 degrees, known to a tenth with speckle's dark spots.
    assert [each.speckle_relative for each in muscle] == pytest.approx([0.0132, 0.0194], rel=0.15)
    assert np.degrees(turned) == pytest.approx([0.093, 0.487], rel=0.15)


def test_speckle_shifts_the_tracked_region_like_independent_cells():
    """Of a long gate: sigma^2 / 2 over its number of independent cells, less one.

    Echo and echo weighted by place are circular Gaussian and independent of each other; cells by the pulse's own
    correlation. 2000 draws: 1.6 % of a standard deviation, three of them, and as much for cells that are not whole.
    """
    gate_m, deep_m = 6e-3, 50e-3
    resting = resting_conditions(load_scene("gelatin-moduli"))
    # as many scatterers, in a beam so deep that all of the gate counts alike
    resting = replace(resting, gate_length_m=gate_m, tracking_width_m=(*TRACKING_M[:2], deep_m))
    instant_m = (np.arange(256) + 0.5) / 256 * gate_m
    lag = np.abs(instant_m[:, None] - instant_m) / PULSE_M
    shift = np.linspace(-1, 1, 2001)
    pulse = np.where(np.abs(shift) < 0.5, np.cos(np.pi * shift) ** 2, 0.0)
    correlation = np.interp(lag, shift[1000:] * 2, np.correlate(pulse, pulse, "full")[2000::2] / (pulse @ pulse))
    cells = lag.size / np.sum(correlation**2)
    area_spread, lateral_spread_m, _ = region_spread(resting, "coherent")
    assert lateral_spread_m == pytest.approx(TRACKING_M[0] / np.sqrt(2) / np.sqrt(2 * (cells - 1)), rel=0.065)
    # r^2 / 2 of both axes spreads by sigma^2, as x does by sigma
    assert area_spread == pytest.approx(lateral_spread_m / (TRACKING_M[0] / np.sqrt(2)), rel=0.065)


def test_a_declared_aperture_lowers_the_factor_and_widens_its_uncertainty() -> None:
    scene = load_scene("bovine-muscle")
    plain = predicted_averaging(scene, "coherent")[0]
    oblique = predicted_averaging(scene.with_({"beams.transducer_diameter_m": 45e-3}), "coherent")[0]
    assert plain is not None
    assert oblique is not None
    # its force is no Gaussian either: the twin's field under both, over the echoes' energy
    beams = beam_widths(scene, "coherent")
    assert beams is not None
    lateral_m, (node, weight) = np.linspace(0, 0.28e-3, 40), np.polynomial.hermite.hermgauss(5)
    energy = np.exp(-((lateral_m / beams.tracking_width_m[0]) ** 2)) * lateral_m
    depth_m = np.sqrt(2) * beams.depth_sd_m * node
    settings = SimulationSettings.model_validate({"beams": {"field": "aperture"}, "specimen": {}})
    specimen, hz = Specimen(shear_modulus_pa=9e3, shear_viscosity_pa_s=2.0), np.array([scene.wanted_frequencies_hz[0]])
    aperture, gaussian = (
        energy @ field[0] @ weight / energy.sum() / weight.sum() / field[0, 0, 2]
        for field in (
            field_transfer(specimen, force, lateral_m, depth_m, hz)
            for force in (push_intensity(settings), (0.34e-3, 0.34e-3, 3.6e-3))
        )
    )
    other = complex(aperture / gaussian)
    assert abs(other) > 1.001
    expected = obliquity_factor(45e-3, 70e-3) * abs(other)
    assert oblique.factor / plain.factor == pytest.approx(expected, abs=2e-4)
    # it lags more, by 0.04 degrees in this beam
    assert np.angle(other) < -6e-4
    assert oblique.phase_rad - plain.phase_rad == pytest.approx(np.angle(other), abs=1e-4)
    assert oblique.rule.geometry_phase_rad == pytest.approx(np.angle(other), abs=1e-4)
    assert (plain.shape_relative, oblique.shape_relative) == (0.0, SHAPE_RELATIVE)


@pytest.mark.parametrize("estimator", ["coherent", "kasai"])
def test_gates_without_an_echo_are_left_out(estimator: str) -> None:
    """Two scatterers a gate on the mean: one gate in eight holds none, and has neither phase nor peak."""
    scene = load_scene("bovine-muscle").with_(
        {"beams.tracking_width_m": (0.5e-3, 0.5e-3, 8e-3), "simulation.scatterers.per_cell": 1.0}
    )
    resting = resting_conditions(scene)
    assert resting is not None
    assert all(np.isfinite(speckle_spread(resting, estimator)))
    speckle = seeded_speckle(resting, 400)
    # exp(-2.08) of 400 and their deviation, and those at the gate's very ends beside them
    assert 300 < len(speckle.resting) < 400
    assert np.isfinite(tracked_over_peak(resting, estimator, speckle)).all()


def test_the_prediction_at_a_frequency_does_not_depend_on_the_other_wanted_ones():
    """Beside the push, where media that hardly move at 700 Hz would make the spread of one alone five times as wide."""
    lateral = "lateral_offset_m = [1.0e-3, 2.25e-3, 3.5e-3, 4.75e-3, 6.0e-3]"
    beside = shipped_scenes()["gelatin-moduli"].replace(lateral, "lateral_offset_m = [3.5e-3]")
    foreseen = []
    for wanted in ("", "frequencies_hz = [700.0]", "frequencies_hz = [100.0, 700.0]"):
        scene = parse_scene("beside", beside.replace("[processing]", f"[processing]\n{wanted}")).scene
        tracking = scene.tracking.model_copy(update={"lateral_offset_m": 3.5e-3})
        found = predicted_averaging(scene.model_copy(update={"tracking": tracking}), "coherent")
        foreseen.append(found[scene.wanted_frequencies_hz.index(700.0)])
    speckle = [(each.speckle_relative, each.speckle_phase_rad) for each in foreseen]
    assert speckle[1:] == [pytest.approx(speckle[0])] * 2
    assert speckle[0][0] < 0.02
