"""Estimated acoustic output against the numbers of the FDA's track 3, and plans that are refused for it."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from datetime import date, timedelta
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from drivers.interfaces import InstrumentError
from hpe_rig.bench import DriveCalibration, OutputLimits, file_differences, read_bench
from hpe_rig.bench.opening import open_bench
from hpe_rig.measurement.setup import prepare, setup_of_run
from hpe_rig.plan.checks.acoustic_output import (
    AcousticOutput,
    _reduction,
    calibration_expiry,
    derating_db,
    drive_output,
    highest_output,
)
from hpe_rig.plan.checks.check_result import CheckResult, PlanError, refuse_conflicts
from hpe_rig.result import Provenance
from hpe_rig.scene import SettingsError, shipped_scenes
from hpe_rig.store import read_run

LIMITS = OutputLimits(full_drive_vpp=1.0, max_duty=0.05, max_burst_length_s=250e-6, max_bursts=200)


def drive(rarefaction_pa: float, sppa_w_per_m2: float = 1.0) -> DriveCalibration:
    return DriveCalibration(
        carrier_hz=3e6, amplitude_vpp=1.0, rarefaction_pa=rarefaction_pa, sppa_w_per_m2=sppa_w_per_m2
    )


def checked(tmp_path: Path, *edits: tuple[str, str]) -> tuple[CheckResult, ...]:
    text = read_bench().text
    for old, new in edits:
        assert old in text, old
        text = text.replace(old, new)
    path = tmp_path / "bench.toml"
    path.write_text(text, encoding="utf-8")
    return prepare("bovine-muscle", path, refuse=False).findings


def of(check: str, found: tuple[CheckResult, ...]) -> list[CheckResult]:
    return [finding for finding in found if finding.check == check]


def test_output_is_derated_by_a_third_of_a_decibel_a_centimetre_and_megahertz() -> None:
    assert derating_db(3e6, 0.07) == pytest.approx(6.3, rel=1e-12)


def test_nothing_is_estimated_without_a_calibration() -> None:
    setup = prepare("bovine-muscle")
    bench = setup.bench.bench.model_copy(update={"calibration": None})
    assert highest_output(bench, setup.plan.shots) == AcousticOutput(0.0, 0.0, 0.0)
    assert highest_output(setup.bench.bench, setup.plan.shots).mechanical_index > 0


def test_the_mechanical_index_of_3_29_megapascal_at_3_megahertz_is_the_limit() -> None:
    output = drive_output(drive(1.9e6 * 3**0.5), 0.0, 1.0, 0.01)
    assert output.mechanical_index == pytest.approx(1.9, rel=1e-12)


@pytest.mark.parametrize(("sppa_w_per_cm2", "good"), [(71.9, True), (72.1, False)])
def test_one_per_cent_of_72_watts_a_square_centimetre_is_the_limit_of_the_time_average(
    sppa_w_per_cm2: float, good: bool
) -> None:
    assert drive_output(drive(1e6, sppa_w_per_cm2 * 1e4), 0.0, 1.0, 0.01).within(LIMITS) is good


@pytest.mark.parametrize(
    ("rarefaction_pa", "sppa_w_per_cm2", "good"),
    [(3.0e6, 200.0, True), (3.6e6, 180.0, True), (3.6e6, 200.0, False)],
)
def test_either_the_mechanical_index_or_the_pulse_average_must_be_within_its_limit(
    rarefaction_pa: float, sppa_w_per_cm2: float, good: bool
) -> None:
    assert drive_output(drive(rarefaction_pa, sppa_w_per_cm2 * 1e4), 0.0, 1.0, 1e-3).within(LIMITS) is good


@given(st.floats(1e-3, 10.0), st.floats(1e-4, 0.5))
def test_pressure_goes_with_the_drive_and_intensity_with_its_square(amplitude_vpp: float, duty: float) -> None:
    one, other = (drive_output(drive(1e6, 1e5), 0.07, volts, duty) for volts in (1.0, amplitude_vpp))
    assert other.mechanical_index == pytest.approx(one.mechanical_index * amplitude_vpp, rel=1e-12)
    assert other.spta_w_per_m2 == pytest.approx(one.sppa_w_per_m2 * amplitude_vpp**2 * duty, rel=1e-12)


def test_too_much_output_is_refused_before_anything_opens_with_both_numbers_and_what_to_lower(tmp_path: Path) -> None:
    found = checked(tmp_path, ("sppa_w_per_m2 = 5.2e4", "sppa_w_per_m2 = 3.08e6"))
    (finding,) = of("acoustic output", found)
    # 3.08e6 W/m2 derated by 6.3 dB, on for 1 %: 722 mW/cm2, of which 720 are 99.7 %.
    assert finding.level == "refused"
    assert "I_spta 722 mW/cm2 (limit 720)" in finding.text
    assert "99.9 %" in finding.remedy
    assert "burst_length_s of 99.7 %" in finding.remedy
    with pytest.raises(PlanError, match="I_spta 722"):
        refuse_conflicts(found)


@pytest.mark.parametrize("to_spare", [0.8, 1.0, 1.5, 3.0])
def test_shorter_bursts_are_offered_where_the_time_average_alone_is_too_much(to_spare: float) -> None:
    limits = read_bench().bench.limits
    index = limits.max_mechanical_index / to_spare
    sppa = 10 * limits.max_sppa_w_per_m2
    remedy = _reduction(AcousticOutput(index, sppa, 2 * limits.max_spta_w_per_m2), limits)
    assert ("burst_length_s of 50 %" in remedy) == (to_spare >= 1)
    assert "burst_length_s" not in _reduction(AcousticOutput(index, sppa, limits.max_spta_w_per_m2), limits)


def test_a_bench_without_calibration_is_told_that_nothing_was_estimated(tmp_path: Path) -> None:
    text = read_bench().text
    section = text[text.index("[calibration]") : text.index("[generators.master]")]
    (finding,) = of("acoustic output", checked(tmp_path, (section, "")))
    assert finding.level == "warning"
    assert "no [calibration]" in finding.text


def test_a_calibration_at_another_carrier_is_told_not_to_hold(tmp_path: Path) -> None:
    warning, _ = of("acoustic output", checked(tmp_path, ("carrier_hz = 3.0e6", "carrier_hz = 2.5e6")))
    assert "3 MHz was calibrated at 2.5 MHz" in warning.text


def test_a_drive_beyond_the_benchs_limit_is_refused(tmp_path: Path) -> None:
    burst, pulse = of("drive", checked(tmp_path, ("max_drive_vpp = 2.0", "max_drive_vpp = 0.9")))
    assert burst.level == pulse.level == "refused"
    assert "toneburst of 1 Vpp, limits.max_drive_vpp = 0.9 Vpp" in burst.text


def test_the_longest_toneburst_of_a_sweep_is_held_against_the_limits(tmp_path: Path) -> None:
    text = shipped_scenes()["bovine-muscle"]
    once = "burst_length_s = 100e-6"
    assert text.count(once) == 1
    (tmp_path / "sweep.toml").write_text(
        text.replace(once, "burst_length_s = [60e-6, 300e-6, 60e-6]"), encoding="utf-8"
    )
    bench = tmp_path / "bench.toml"
    bench.write_text(read_bench().text.replace("max_duty = 0.05", "max_duty = 0.02"), encoding="utf-8")
    found = prepare(str(tmp_path / "sweep.toml"), bench, refuse=False).findings
    assert "refused" in {finding.level for finding in of("duty", found)}
    assert "refused" in {finding.level for finding in of("burst length", found)}


def test_the_drivers_themselves_refuse_a_swing_beyond_what_an_output_is_wired_for(tmp_path: Path) -> None:
    bench = tmp_path / "bench.toml"
    roles = ("master", "burst_train", "toneburst", "tracking_train", "tracking_pulser")
    text = read_bench().text
    for role in roles:
        text = text.replace(f"[generators.{role}]", f"[generators.{role}]\nmax_vpp = 0.5")
    bench.write_text(text, encoding="utf-8")
    setup = prepare("bovine-muscle", bench, refuse=False)
    with open_bench(setup.scene.scene, setup.bench.bench, setup.plan.roles) as opened:
        for role in roles:
            with pytest.raises(InstrumentError, match=rf"{role}: .* above max_vpp = 0\.5"):
                getattr(opened, role).configure(getattr(setup.plan.shots[0], role))


def test_the_drivers_themselves_refuse_a_drive_beyond_the_benchs_limit() -> None:
    setup = prepare("bovine-muscle")
    burst = setup.plan.shots[0].toneburst
    assert burst is not None
    with open_bench(setup.scene.scene, setup.bench.bench, setup.plan.roles) as bench:
        assert bench.toneburst is not None
        bench.toneburst.configure(replace(burst, amplitude_vpp=2.0))
        for drive_generator in (bench.toneburst, bench.tracking_pulser):
            with pytest.raises(InstrumentError, match=r"2\.1"):
                drive_generator.configure(replace(burst, amplitude_vpp=2.1))


def test_an_expired_calibration_is_refused_on_a_real_bench_and_reported_on_the_twin(
    tmp_path: Path, real_bench: Callable[..., Path]
) -> None:
    def real(keys: str) -> Path:
        return real_bench(("focus_depth_m", f"{keys}\nfocus_depth_m"))

    yesterday = date.today() - timedelta(days=1)
    with pytest.raises(PlanError, match=rf"expired: calibration.valid_until = {yesterday}.*valid_until"):
        prepare("bovine-muscle", real(f"date = 2020-01-31\nvalid_until = {yesterday}"))
    assert not of("calibration", prepare("bovine-muscle", real("date = 2020-01-31")).findings)
    (today,) = of("calibration", prepare("bovine-muscle", real(f"valid_until = {date.today()}")).findings)
    assert today.level == "passed"
    (twin,) = of("calibration", checked(tmp_path, ("focus_depth_m", f"valid_until = {yesterday}\nfocus_depth_m")))
    assert twin.level == "warning"


def test_a_calibration_of_a_later_day_is_refused_on_a_real_bench() -> None:
    bench = read_bench().bench
    assert bench.calibration is not None
    calibration = bench.calibration.model_copy(update={"date": date(2026, 3, 5)})
    for simulated, expected in ((False, "refused"), (True, "warning")):
        dated = bench.model_copy(update={"calibration": calibration, "simulated": simulated})
        levels = [[result.level for result in calibration_expiry(dated, date(2026, 3, day))] for day in (4, 5)]
        assert levels == [[expected], []]


def test_a_calibration_is_valid_to_the_end_of_its_last_day() -> None:
    bench = read_bench().bench
    assert bench.calibration is not None
    calibration = bench.calibration.model_copy(update={"valid_until": date(2026, 3, 5)})
    dated = bench.model_copy(update={"calibration": calibration, "simulated": False})
    levels = [result.level for day in (5, 6) for result in calibration_expiry(dated, date(2026, 3, day))]
    assert levels == ["passed", "refused"]


def test_the_uncertainty_of_the_calibration_is_stated_with_the_output(tmp_path: Path) -> None:
    edit = ("focus_depth_m = 70e-3\n\n[calibration.t", "focus_depth_m = 70e-3\nu = 0.1\n\n[calibration.t")
    (finding,) = of("acoustic output", checked(tmp_path, edit))
    values = re.search(r"derated MI (\S+) \+- (\S+) .* I_sppa (\S+) \+- (\S+) W", finding.text)
    assert values is not None
    index, index_u, intensity, intensity_u = map(float, values.groups())
    assert index_u == pytest.approx(0.1 * index, rel=0.06)
    assert intensity_u == pytest.approx(0.2 * intensity, rel=0.06)


def test_a_date_in_quotes_is_a_mistake_that_shows_how_a_date_is_written(tmp_path: Path) -> None:
    path = tmp_path / "bench.toml"
    path.write_text(read_bench().text.replace("focus_depth_m", 'date = "2026-03-05"\nfocus_depth_m'), encoding="utf-8")
    with pytest.raises(SettingsError, match=r"calibration.date.*a date such as 2026-03-05, without quotes"):
        read_bench(path)


def test_the_dates_of_two_bench_files_are_compared() -> None:
    before, after = {"calibration": {"date": date(2026, 3, 5)}}, {"calibration": {"date": date(2027, 3, 5)}}
    (difference,) = file_differences(before, after)
    assert difference.text("A", "B") == "bench file: calibration date 2026-03-05 in A, 2027-03-05 in B"
    assert not file_differences(before, before)


@pytest.mark.parametrize(("started", "level"), [("2026-03-05T23:00:00+01:00", "passed"), ("2026-03-06", "warning")])
def test_a_stored_run_is_checked_for_the_day_of_its_measurement(started: str, level: str) -> None:
    stored = read_run(Path(__file__).parents[3] / "fixtures" / "run_files" / "specimen.h5")
    assert not of("calibration", setup_of_run(stored).findings)
    bench = stored.bench_toml.replace("focus_depth_m", "valid_until = 2026-03-05\nfocus_depth_m", 1)
    dated = replace(stored, bench_toml=bench, provenance=Provenance(started=started))
    assert [finding.level for finding in of("calibration", setup_of_run(dated).findings)] == [level]
