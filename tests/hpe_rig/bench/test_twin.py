"""What a scene declares of its twin, with defaults, presets and the scene's own sections filled in."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hpe_rig.bench import TwinDeclaration, check_declared, read_bench, twin_of, twin_tables
from hpe_rig.scene import Scene, parse_scene, shipped_scenes
from sim_backend.settings import SimulationSettings

SCENES = shipped_scenes()


def scene(name: str, *edits: tuple[str, str]) -> Scene:
    text = SCENES[name]
    for old, new in edits:
        assert old in text
        text = text.replace(old, new)
    return parse_scene(name, text).scene


def test_a_prescribed_motion_is_declared_with_its_amplitudes() -> None:
    twin = twin_of(scene("table-1"))
    assert twin is not None
    assert twin.prescribed == ((200.0, 1e-6),)
    assert twin.medium(np.array([200.0])) is None


def test_a_voigt_specimen_is_declared_as_modulus_and_density() -> None:
    twin = twin_of(scene("bovine-muscle"))
    assert twin is not None
    assert not twin.prescribed
    modulus_pa, density = twin.medium(np.array([100.0, 200.0])) or (np.zeros(2), 0.0)
    np.testing.assert_allclose(modulus_pa, 12.0e3 + 2j * np.pi * np.array([100.0, 200.0]) * 5.7, rtol=1e-12)
    assert density == 1060.0


def test_a_preset_brings_the_chains_noise_along() -> None:
    with_preset, bare = (
        twin_of(scene("gelatin-8", *edits))
        for edits in ([], [('preset = "paper"', ""), ("noise_v_per_sqrt_hz", "# noise_v_per_sqrt_hz")])
    )
    assert with_preset is not None
    assert bare is not None
    assert with_preset.has_noise
    assert not bare.has_noise


def test_where_the_twin_is_silent_the_scenes_own_sound_speed_holds() -> None:
    own = scene("table-1")
    faster = own.model_copy(update={"acquisition": own.acquisition.model_copy(update={"sound_speed_m_per_s": 1580.0})})
    simulation = {key: value for key, value in (own.simulation or {}).items() if key != "sound_speed_m_per_s"}
    twin = twin_of(faster.model_copy(update={"simulation": simulation}))
    assert twin is not None
    assert twin.sound_speed_m_per_s == 1580.0


def test_a_scene_without_simulation_declares_no_twin() -> None:
    bare = scene("table-1").model_copy(update={"simulation": None})
    assert twin_of(bare) is None
    assert check_declared(bare) == []


@pytest.mark.parametrize("wrong", [{"sede": 1}, {"seed": -1}])
def test_an_invalid_twin_is_told_by_the_check_and_declares_nothing(wrong: dict[str, int]) -> None:
    invalid = scene("table-1").model_copy(update={"simulation": wrong})
    assert twin_of(invalid) is None
    assert [mistake.path for mistake in check_declared(invalid)] == [f"simulation.{next(iter(wrong))}"]


@pytest.mark.parametrize(
    ("stated", "depth_m"),
    [
        ({}, 12.5e-3),
        ({"scatterers": {"attenuation_db_per_cm_mhz": 0.5}}, None),
        ({"scatterers": {"attenuation_db_per_cm_mhz": 0.0}}, 12.5e-3),
        ({"propagation": {"specimen_depth_m": 20e-3}}, 20e-3),
        ({"beams": {"focus_depth_m": 10e-3}}, 10e-3),
        ({"beams": {"focus_depth_m": 70e-3, "tracking_focus_depth_m": 11e-3}}, 11e-3),
    ],
)
def test_the_depth_of_a_preset_gives_way_to_what_a_scene_says(
    stated: dict[str, dict[str, float]], depth_m: float | None
) -> None:
    """Run files from before presets had a depth open as well."""
    found = SimulationSettings.model_validate({"specimen": {"preset": "gelatin_8"}, **stated}).specimen
    assert found is not None
    assert found.depth_m == depth_m


def test_a_depth_that_a_scene_itself_says_is_not_overruled() -> None:
    given = {"specimen": {"preset": "gelatin_8", "depth_m": 15e-3}, "propagation": {"specimen_depth_m": 20e-3}}
    with pytest.raises(ValueError, match="at one depth"):
        SimulationSettings.model_validate(given)


def test_noise_without_a_receive_chain_follows_from_the_echo_and_its_ratio() -> None:
    noisy, silent = twin_of(scene("table-1")), twin_of(scene("table-1", ("snr_db", "# snr_db")))
    assert noisy is not None
    assert silent is not None
    assert (noisy.has_noise, silent.has_noise, silent.noise_v) == (True, False, 0.0)
    # 40 dB are a factor of 100 in volts.
    assert noisy.noise_v == pytest.approx(noisy.settings.receiver.echo_rms_v / 100)


def test_only_driven_tonebursts_displace_the_specimen() -> None:
    twin = twin_of(scene("bovine-muscle"))
    assert twin is not None
    time_s, onset_s = np.array([5e-3]), np.array([0.0])
    pushed_m, undriven_m = (twin.displacement_m(time_s, onset_s, 100e-6, drive)[0] for drive in ((3e6, 1.0), None))
    assert pushed_m != undriven_m
    assert undriven_m == 0.0


def test_the_displacement_at_a_time_does_not_depend_on_the_other_times() -> None:
    twin = twin_of(scene("bovine-muscle"))
    assert twin is not None
    time_s, onset_s = np.array([0.5, 5.0, 15.0, 25.0]) * 1e-3, np.array([1.0, 11.0, 21.0]) * 1e-3
    together_m = twin.displacement_m(time_s, onset_s, 100e-6, (3e6, 1.0))
    single_m = [twin.displacement_m(time_s[[k]], onset_s, 100e-6, (3e6, 1.0))[0] for k in range(4)]
    assert together_m[0] == 0.0
    np.testing.assert_allclose(together_m, single_m, rtol=1e-9, atol=0)
    assert np.all(together_m[1:] > 0)


def declared(name: str, simulation: dict[str, Any]) -> TwinDeclaration:
    """Return the twin of the shipped scene ``name`` with ``simulation`` in the place of its [simulation]."""
    twin = twin_of(scene(name).model_copy(update={"simulation": simulation}))
    assert twin is not None
    return twin


def test_scatterers_or_reflectors_make_echoes_up_to_the_farthest_of_them() -> None:
    reflector = {"reflectors": [{"position_m": (0.0, 0.0, -4e-3)}, {"position_m": (0.0, 0.0, 1e-3)}]}
    nothing, reflectors, scatterers, both = (
        declared("table-1", {"scatterers": settings})
        for settings in ({"per_cell": 0.0}, {"per_cell": 0.0, **reflector}, {}, reflector)
    )
    assert [twin.has_echoes for twin in (nothing, reflectors, scatterers, both)] == [False, True, True, True]
    # Without reflectors half the depth of the scatterers, 5 mm by default.
    assert [twin.echo_reach_m for twin in (nothing, reflectors, scatterers, both)] == [0.0, 4e-3, 2.5e-3, 4e-3]


def test_clock_errors_are_those_of_any_instrument() -> None:
    settings: tuple[dict[str, Any], ...] = (
        {},
        {"clock_error": {"toneburst": 1e-6}},
        {"clock_error": {"digitizer": 1e-6}},
    )
    assert [declared("table-1", {"instruments": errors}).has_clock_errors for errors in settings] == [False, True, True]
    slow = declared("table-1", {"instruments": {"clock_error": {"burst_train": -2e-6}}})
    assert slow.burst_clock_rate == pytest.approx(1 - 2e-6, abs=1e-12)


def test_the_length_of_an_echo_is_that_of_its_bandwidth() -> None:
    burst, hann = (
        declared("table-1", {"scatterers": settings}).echo_pulse_s(5e6)
        for settings in (
            {"pulse": "burst", "band_centre_hz": 8e6, "bandwidth": 0.5},
            {"bandwidth": 0.5},
        )
    )
    # Half of the transducer's 8 MHz; half of the carrier's 5 MHz.
    assert (burst, hann) == pytest.approx((250e-9, 400e-9), rel=1e-12)


def test_the_echo_level_follows_amplitude_length_distance_and_loss() -> None:
    twin = declared("table-1", {"specimen": {"depth_m": 20e-3}})
    receiver, width_m = twin.settings.receiver, twin.settings.beams.tracking_width_m[2]
    reference_v = twin.echo_v(1.0, 3.0, receiver.reference_carrier_hz)
    assert reference_v == pytest.approx(receiver.echo_rms_v, rel=1e-12)
    assert twin.echo_v(0.5, 6.0, 9e6) == pytest.approx(reference_v, rel=1e-12)
    # One sigma off the focus the beam's Gaussian is exp(-1/2); beyond the scatterers it is that at their end.
    assert twin.echo_v(1.0, 3.0, 9e6, width_m) == pytest.approx(reference_v * np.exp(-0.5), rel=1e-12)
    assert twin.echo_v(1.0, 3.0, 9e6, 1.0) == twin.echo_v(1.0, 3.0, 9e6, twin.echo_reach_m) > 0
    loss_db = twin.settings.loss_to_focus_db(10e6) - twin.settings.loss_to_focus_db(9e6)
    assert loss_db > 0
    assert twin.echo_v(1.0, 3.0, 10e6) == pytest.approx(reference_v * 10 ** (-loss_db / 20), rel=1e-12)


def test_prescribed_components_of_one_frequency_add_up_with_their_phases_at_the_start() -> None:
    motion = [
        {"frequency_hz": 200.0, "amplitude_m": 3e-6},
        {"frequency_hz": 200.0, "amplitude_m": 4e-6, "phase_rad": 0.5 * np.pi},
    ]
    twin = declared("table-1", {"motion": [*motion, {"frequency_hz": 300.0, "amplitude_m": 1e-6}]})
    assert twin.prescribed_phasor_m(200.0) == pytest.approx(3e-6 + 4e-6j, abs=1e-18)
    # An eighth of a period later every phase is larger by 45 degrees.
    assert twin.prescribed_phasor_m(200.0, 5e-3 / 8) == pytest.approx((3e-6 + 4e-6j) * np.exp(0.25j * np.pi), abs=1e-18)
    time_s = np.array([0.4e-3, 1.1e-3])
    expected_m = sum((twin.prescribed_phasor_m(hz) * np.exp(2j * np.pi * hz * time_s)).imag for hz in (200.0, 300.0))
    np.testing.assert_allclose(twin.displacement_m(time_s, np.zeros(0), 1e-4, None), expected_m, rtol=1e-9)


def test_what_a_declaration_lacks_is_none() -> None:
    at_rest = declared("table-1", {"motion": []})
    assert at_rest.background_m(np.array([0.1])) is None
    assert at_rest.push(3e6) is None
    assert at_rest.water_output(1e5, 3e6) is None
    assert at_rest.medium(np.array([100.0])) is None
    assert at_rest.foreign_medium is None
    assert at_rest.steady_response_m(100.0) == 0.0
    excitation = scene("bovine-muscle").excitation
    assert excitation is not None
    frequency_hz = np.array([100.0])
    assert at_rest.dose(excitation, 1e-4, frequency_hz) is None
    reflector = {"per_cell": 0.0, "reflectors": [{}]}
    sphere = declared("bovine-muscle", {"specimen": {"sphere": {}, "field": "gaussian"}, "scatterers": reflector})
    assert sphere.dose(excitation, 1e-4, frequency_hz) is None
    muscle = declared("bovine-muscle", {"specimen": {}})
    assert muscle.foreign_medium is None
    assert muscle.dose(excitation, 1e-4, frequency_hz) is not None
    # A displacement by the Gaussian of eq. (12) has no modulus.
    assert declared("bovine-muscle", {"specimen": {"field": "gaussian"}}).medium(frequency_hz) is None
    with pytest.raises(OverflowError, match="106 days"):
        declared("table-1", {"background": [{"frequency_hz": 1.0, "amplitude_m": 1e-6}]}).background_m(np.array([1e7]))


def test_the_record_is_deeper_than_planned_by_the_latencies_that_the_bench_file_does_not_state() -> None:
    bench = read_bench().bench
    planned_s = bench.digitizer.latency_s - bench.digitizer.aux_latency_s - bench.generators.tracking_pulser.latency_s

    def shift_s(**instruments: Any) -> float:
        twin = declared("table-1", {"sound_speed_m_per_s": 1500.0, "instruments": instruments})
        return twin.depth_shift_m(bench, 10e-6) / 750.0

    assert shift_s(generator_latency_s=100e-9) == pytest.approx(-100e-9 - planned_s, abs=1e-15)
    latencies = {"generator_latency_s": 100e-9, "digitizer_latency_s": 300e-9, "aux_latency_s": 50e-9}
    assert shift_s(**latencies) == pytest.approx(150e-9 - planned_s, abs=1e-15)
    # A board whose AUX output waits for the trigger delay, unlike in the bench file: the pulse comes 10 us later.
    assert not bench.digitizer.aux_waits_for_trigger_delay
    assert shift_s(**latencies, aux_waits_for_trigger_delay=True) == pytest.approx(
        150e-9 - planned_s - 10e-6, abs=1e-15
    )
    waiting = bench.model_copy(
        update={"digitizer": bench.digitizer.model_copy(update={"aux_waits_for_trigger_delay": True})}
    )
    # Stated latencies of the digitizer and of its AUX output count in opposite directions.
    stated = {"latency_s": 300e-9, "aux_latency_s": 50e-9}
    known = bench.model_copy(update={"digitizer": bench.digitizer.model_copy(update=stated)})
    twin = declared("table-1", {"sound_speed_m_per_s": 1500.0, "instruments": latencies})
    assert twin.depth_shift_m(known, 0.0) == pytest.approx(0.0, abs=1e-12)
    twin = declared("table-1", {"instruments": {**latencies, "aux_waits_for_trigger_delay": True}})
    assert twin.depth_shift_m(waiting, 10e-6) == twin.depth_shift_m(waiting, 0.0)


@pytest.mark.parametrize(
    ("dual_port", "mode", "record_samples", "records"),
    [
        (True, "traditional", 2048, np.inf),
        (False, "traditional", 2048, 4),
        (True, "single_port", 2048, 4),
        (True, "traditional", 1 << 20, 0),
    ],
)
def test_records_of_a_capture_fit_the_boards_memory_unless_they_are_read_meanwhile(
    dual_port: bool, mode: str, record_samples: int, records: float
) -> None:
    bench = read_bench().bench
    board = bench.digitizer.model_copy(update={"acquisition_mode": mode})
    memory = 4 * (2048 + board.board_model.record_overhead_samples)
    twin = declared("table-1", {"instruments": {"samples_per_channel": memory, "dual_port_memory": dual_port}})
    assert twin.max_records(bench.model_copy(update={"digitizer": board}), record_samples) == records


def test_the_twins_tables_have_the_scenes_beams_unless_the_simulation_states_its_own() -> None:
    declaring = scene("bovine-muscle", ("[beams]\n", "[beams]\nfocus_depth_m = 60e-3\npush_focus_depth_m = 65e-3\n"))
    beams = twin_tables(declaring)["beams"]
    assert (beams["tracking_focus_depth_m"], beams["focus_depth_m"]) == (60e-3, 65e-3)
    assert not {"pulse_length_m", "push_focus_depth_m"} & beams.keys()
    simulation = {**(declaring.simulation or {}), "beams": {"focus_depth_m": 55e-3}}
    assert twin_tables(declaring.model_copy(update={"simulation": simulation}))["beams"]["focus_depth_m"] == 55e-3
    one = scene("bovine-muscle", ("[beams]\n", "[beams]\nfocus_depth_m = 60e-3\n"))
    assert "tracking_focus_depth_m" not in twin_tables(one)["beams"]
    assert "beams" in twin_tables(one.model_copy(update={"beams": None}))
