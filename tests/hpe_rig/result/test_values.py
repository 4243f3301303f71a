"""One name has one meaning: the headline values have the same names in every table, and shots count from 1."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import h5py
import pytest

from hpe_rig.result import Estimate, Result, ShotResult
from hpe_rig.result.repeats import repeat_means
from hpe_rig.result.rows import result_csv
from hpe_rig.store import write_result

CORRECTED = Estimate(200.0, 0.9e-6, 2e-9, 0.5, 2e-3, averaging_factor=0.9, averaging_phase_rad=-0.1)
TRACKED = Estimate(200.0, 0.9e-6, 2e-9, 0.5, 2e-3)


def result(estimate: Estimate) -> Result:
    shots = [ShotResult(index, index, None, None, 100, 0, 1e-9, (estimate,), ()) for index in range(2)]
    return Result("t", "t.h5", True, "complete", "coherent", "burst", tuple(shots), (), (), {}, {})


@pytest.mark.parametrize(("estimate", "amplitude_m", "phase_rad"), [(CORRECTED, 1e-6, 0.6), (TRACKED, 0.9e-6, 0.5)])
def test_every_table_states_the_headline_and_counts_shots_from_1(
    estimate: Estimate, amplitude_m: float, phase_rad: float, tmp_path: Path
) -> None:
    stated, path = result(estimate), tmp_path / "t.coherent.h5"
    assert (estimate.amplitude_m, estimate.phase_rad) == pytest.approx((amplitude_m, phase_rad))
    json, csv_row, frame_row, dataset = (
        stated.as_dict()["shots"][1],
        list(csv.DictReader(io.StringIO(result_csv(stated))))[1],
        stated.to_frame().iloc[1],
        stated.to_xarray().sel(shot=2, frequency=200.0),
    )
    write_result(path, stated)
    with h5py.File(path) as file:
        stored = {name: float(values[1, 0]) for name, values in file["results"].items() if values.ndim == 2}
        assert file["results/shot"][:].tolist() == [1, 2]
    assert [int(json["shot"]), int(csv_row["shot"]), int(frame_row["shot"]), int(dataset.shot)] == [2] * 4
    for name in ("amplitude_m", "amplitude_uncertainty_m", "phase_rad", "phase_uncertainty_rad"):
        for prefix, value in (
            ("", getattr(estimate, name)),
            ("tracked_", getattr(estimate, f"tracked_{name}")),
        ):
            row = json["estimates"][0], csv_row, frame_row, dataset, stored
            assert [float(table[f"{prefix}{name}"]) for table in row] == [value] * 5
    assert json["estimates"][0]["corrected"] is estimate.corrected


def test_an_earlier_name_is_read_with_a_warning_that_names_the_present_one() -> None:
    with pytest.warns(FutureWarning, match="corrected_uncertainty_m is called amplitude_uncertainty_m since"):
        assert CORRECTED.corrected_uncertainty_m == CORRECTED.amplitude_uncertainty_m  # type: ignore[attr-defined]
    with pytest.warns(FutureWarning, match="is called amplitude_m"):
        assert TRACKED.corrected_amplitude_m is None  # type: ignore[attr-defined]
    with pytest.warns(FutureWarning, match="headline"):
        assert CORRECTED.headline is CORRECTED  # type: ignore[attr-defined]
    (mean,) = repeat_means(result(CORRECTED).shots)
    with pytest.warns(FutureWarning, match="headline are those of the RepeatMean itself"):
        assert mean.headline is mean  # type: ignore[attr-defined]
    with pytest.raises(AttributeError, match="'Estimate' object has no attribute 'amplitude'"):
        TRACKED.amplitude  # type: ignore[attr-defined]  # noqa: B018
