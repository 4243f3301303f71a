"""The main job on every digitizer board: one line of the bench file changes, and everything else is the same."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from drivers.alazar import model_named
from hpe_rig.bench import read_bench
from hpe_rig.measurement.run import record_run
from hpe_rig.measurement.setup import Setup, prepare
from hpe_rig.plan.checks.check_result import PlanError
from hpe_rig.runs.run import open_run, process

Prepared = Callable[..., Setup]
# Bits, and the smallest range for echoes of up to 0.8 V: from the boards' data sheets.
BOARDS = {
    "ATS460": (14, 0.8),
    "ATS9350": (12, 1.0),
    "ATS9440": (14, 1.0),
    "ATS9462": (16, 0.8),
    "ATS9870": (8, 1.0),
}
MODES = ("single_port", "traditional", "npt")
FAST = {
    ("ATS460", "single_port"),
    ("ATS9870", "npt"),
}
"""One board in single-port mode, one in NPT mode; the other pairs are marked slow."""


def bench_of(folder: Path, model: str, *lines: str) -> Path:
    text = read_bench().text.replace('model = "ATS460"', "\n".join([f'model = "{model}"', *lines]))
    path = folder / f"{model}.toml"
    path.write_text(text, encoding="utf-8")
    return path


def measured(setup: Setup, path: Path) -> SimpleNamespace:
    """Return volts, trigger times and estimates of a run, and how far in samples its records stand after the pulses."""
    run = open_run(record_run(setup, path))
    records, shot = run.records[0], run.plan.shots[0]
    assert records.valid.all()
    return SimpleNamespace(
        capture=shot.capture,
        records=records,
        volts=records.codes * records.volts_per_code + records.volts_offset,
        start=round(shot.timeline.record_offset_s[0] * shot.capture.sample_rate_hz),
        period_s=1 / shot.tracking_train.rate_hz,
        estimates=process(path).shots[0].estimates,
    )


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    return measured(prepare("bovine-muscle"), tmp_path_factory.mktemp("reference") / "run.h5")


@pytest.mark.parametrize(
    ("model", "mode"),
    [
        pytest.param(model, mode, marks=() if (model, mode) in FAST else pytest.mark.slow)
        for model in BOARDS
        for mode in MODES
    ],
)
def test_the_main_job_on_every_board_and_in_every_way_to_capture(
    reference: SimpleNamespace, tmp_path: Path, model: str, mode: str
) -> None:
    bits, range_v = BOARDS[model]
    bench = bench_of(tmp_path, model, f'acquisition_mode = "{mode}"')
    run = measured(prepare("bovine-muscle", bench), tmp_path / "run.h5")
    assert run.capture.input_range_v == range_v
    # Codes to volts: a range of +-R spans 2^bits - 1 steps.
    code_v = 2 * range_v / (2**bits - 1)
    assert run.records.volts_per_code == pytest.approx(code_v, rel=1e-12)
    assert np.abs(run.records.codes).max() > 2 ** (bits - 1) / 20
    # Delays in coarser steps put the record up to 15 samples earlier; the samples themselves fall on other instants of
    # the receiver's noise then, and are compared as estimates alone.
    assert -15 <= run.start - reference.start <= 0
    if run.start == reference.start:
        half_a_code_each_v = 0.5 * (code_v + reference.records.volts_per_code) * (1 + 1e-9)
        assert np.max(np.abs(run.volts - reference.volts)) <= half_a_code_each_v
    if mode == "npt":
        assert np.isnan(run.records.trigger_time_s).all()
    else:
        # On the clock on the wall, within the counter's step: four samples of 10 ns at most.
        np.testing.assert_allclose(np.diff(run.records.trigger_time_s), run.period_s, rtol=0, atol=41e-9)
    noise_v = 1e-3  # 40 dB below the scene's echoes of 0.1 V rms
    for one, other in zip(run.estimates, reference.estimates, strict=True):
        # Eight bits step by more than the noise, which then dithers nothing, and the budget says so.
        (rounding,) = (each for each in one.budget if each.source == "quantisation")
        assert (rounding.amplitude_m > 0) == (code_v > noise_v / 0.6)
        # Two draws of the same noise at most: four standard deviations of their difference.
        noise_m = np.sqrt(2) * max(one.amplitude_uncertainty_m, other.amplitude_uncertainty_m)
        allowed_m = 4 * np.hypot(noise_m, rounding.amplitude_m * (one.averaging_factor or 1.0))
        assert abs(one.amplitude_m - other.amplitude_m) <= allowed_m


FASTEST = {"ATS9350": 500e6, "ATS9440": 125e6, "ATS9870": 1e9}


@pytest.mark.parametrize(
    "model", [name if name == "ATS9870" else pytest.param(name, marks=pytest.mark.slow) for name in FASTEST]
)
def test_the_main_job_at_a_boards_highest_rate(prepared: Prepared, tmp_path: Path, model: str) -> None:
    rate_hz = FASTEST[model]
    samples = 512 * round(rate_hz / 100e6)
    fast = ("[acquisition]", f"[acquisition]\nsample_rate_hz = {rate_hz}\nrecord_samples = {samples}")
    run = measured(prepared("table-1", fast, bench=bench_of(tmp_path, model)), tmp_path / "run.h5")
    assert (run.capture.sample_rate_hz, run.capture.record_samples) == (rate_hz, samples)
    np.testing.assert_allclose(np.diff(run.records.trigger_time_s), run.period_s, rtol=0, atol=4.1 / rate_hz)
    for each in run.estimates:
        averaged_m = (each.averaging_factor or 1.0) * each.true_amplitude_m
        assert each.amplitude_m == pytest.approx(averaged_m, abs=5 * each.amplitude_uncertainty_m + 0.1 * averaged_m)


@pytest.mark.parametrize(
    ("model", "edit", "words"),
    [
        ("ATS9440", "input_range_v = 0.8", ["input range", "0.8 V on the ATS9440", "0.4, 1, 2"]),
        ("ATS9462", "sample_rate_hz = 250e6", ["sample rate", "on the ATS9462", "160, 180 MHz"]),
        ("ATS9870", "record_samples = 544", ["record length", "multiples of 64 from 256", "576"]),
        ("ATS9350", "record_samples = 128", ["record length", "multiples of 32 from 256", "256"]),
    ],
)
def test_what_a_board_lacks_is_refused_with_the_plan(
    prepared: Prepared, tmp_path: Path, model: str, edit: str, words: list[str]
) -> None:
    with pytest.raises(PlanError) as raised:
        prepared("table-1", ("[acquisition]", f"[acquisition]\n{edit}"), bench=bench_of(tmp_path, model))
    assert all(word in str(raised.value) for word in words), str(raised.value)


def test_a_board_on_pci_express_streams_without_being_told(tmp_path: Path) -> None:
    path = bench_of(tmp_path, "ATS9440")
    path.write_text(path.read_text(encoding="utf-8").replace("dual_port_memory = true\n", ""), encoding="utf-8")
    board = read_bench(path).bench.digitizer
    assert board.mode == "traditional"
    assert board.board_model == model_named("ATS9440")
