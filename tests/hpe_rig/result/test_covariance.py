"""Covariance of the complex values of a result: what is common to which shots, against sums written out by hand."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import GTC
import h5py
import numpy as np
import pytest
import xarray
from numpy.typing import NDArray

import hpe_rig as hpe
from hpe_rig.arrays import ComplexArray
from hpe_rig.result import Component, Covariance, Estimate, Influence, Result, Scope, ShotResult
from hpe_rig.result.covariance import covariance_of
from hpe_rig.store import StoreError, verify, write_result

FREQUENCIES = 3
NOISE_FREEDOM = 9.0


def influences(rng: np.random.Generator, phasor_m: ComplexArray, medium: ComplexArray) -> tuple[Influence, ...]:
    """Return errors of 1 nm of noise, 10 nm of speckle, 1 % of sound speed, and an unknown medium."""

    def random_m(variables: int) -> ComplexArray:
        parts = rng.standard_normal((2, FREQUENCIES, variables))
        return np.asarray(parts[0] + 1j * parts[1])

    sources: tuple[tuple[str, ComplexArray, Scope, str, float], ...] = (
        ("noise", 1e-9 * random_m(2 * FREQUENCIES), "shot", "noise", NOISE_FREEDOM),
        ("speckle", 1e-8 * random_m(1), "position", "speckle", math.inf),
        ("sound speed", 0.01 * phasor_m[:, None], "run", "sound speed", math.inf),
        ("aliasing", 1e-9 * medium, "run", "medium", math.inf),
        ("beam averaging", 2e-9 * medium, "run", "medium", math.inf),
    )
    return tuple(Influence(*source) for source in sources)


def shots(lateral_m: Sequence[float] = (0.0, 0.0, 1e-3)) -> tuple[ShotResult, ...]:
    """Return one shot at each lateral offset, with three frequencies and the errors of ``influences``."""
    rng, results = np.random.default_rng(3), list[ShotResult]()
    medium = np.asarray(rng.standard_normal((FREQUENCIES, 40)) + 1j * rng.standard_normal((FREQUENCIES, 40)))
    for index, offset_m in enumerate(lateral_m):
        polar = [(1e-6 * rng.uniform(0.5, 1), rng.uniform(-3, 3)) for _ in range(FREQUENCIES)]
        phasor_m = np.array([amplitude_m * np.exp(1j * phase_rad) for amplitude_m, phase_rad in polar])
        estimates = tuple(
            Estimate(
                100.0 * (number + 1), amplitude_m, 1e-9, phase_rad, 1e-3, components=(Component("noise", 1e-9, 0),)
            )
            for number, (amplitude_m, phase_rad) in enumerate(polar)
        )
        results.append(
            ShotResult(
                index=index,
                repeat=index,
                burst_length_s=1e-4,
                force_fraction=1.0,
                pulses_used=100,
                pulses_missing=0,
                residual_m=1e-8,
                estimates=estimates,
                warnings=(),
                lateral_offset_m=offset_m,
                influences=influences(rng, phasor_m, medium),
            )
        )
    return tuple(results)


def by_hand_m2(first: ShotResult, second: ShotResult, sources: Sequence[str]) -> NDArray[np.float64]:
    """Return the covariance (frequency, part, frequency, part) of two shots from sources with the same variables."""
    sums = []
    for shot in (first, second):
        total = sum(item.influence_m for item in shot.influences if item.source in sources)
        sums.append(np.stack([np.real(total), np.imag(total)], axis=1))
    return np.einsum("fpv,gqv->fpgq", *sums)


def test_errors_are_common_to_the_shots_that_their_source_states() -> None:
    measured = shots()
    covariance_m2 = covariance_of([measured]).matrix_m2()
    medium = ("aliasing", "beam averaging")
    for row, first in enumerate(measured):
        for column, second in enumerate(measured):
            common = [("sound speed",), medium]
            common += [("speckle",)] if first.lateral_offset_m == second.lateral_offset_m else []
            common += [("noise",)] if row == column else []
            expected_m2 = sum(by_hand_m2(first, second, sources) for sources in common)
            # Influences of 40 media are stored as those of fewer variables: NEGLIGIBLE_VARIANCE of each variance.
            np.testing.assert_allclose(covariance_m2[row, :, :, column], expected_m2, atol=1e-8 * np.max(expected_m2))


def test_many_media_become_as_many_variables_as_there_are_values() -> None:
    covariance = covariance_of([shots()])
    assert covariance.source.count("aliasing") == covariance.source.count("beam averaging") == 2 * FREQUENCIES
    media = [column for column, source in enumerate(covariance.source) if source in ("aliasing", "beam averaging")]
    # Both depend on the same unknown medium.
    assert np.unique(covariance.variable[:, media]).size == 2 * FREQUENCIES


def test_other_runs_share_the_errors_of_a_run_only() -> None:
    measured = shots()
    between_m2 = covariance_of([measured, measured]).matrix_m2()[0, :, :, 3]
    expected_m2 = by_hand_m2(measured[0], measured[0], ("sound speed",))
    expected_m2 = expected_m2 + by_hand_m2(measured[0], measured[0], ("aliasing", "beam averaging"))
    np.testing.assert_allclose(between_m2, expected_m2, atol=1e-8 * np.max(expected_m2))


def ratio_weights(covariance: Covariance) -> ComplexArray:
    """Return the derivatives of ln(y_2 / y_1) by the values of the first shot."""
    weights = np.zeros(covariance.phasor_m.shape, np.complex128)
    weights[0, :2] = [-1, 1] / covariance.phasor_m[0, :2]
    return weights


def test_what_is_common_leaves_ratios_and_differences() -> None:
    covariance = covariance_of([shots()])
    # Sound speed scales all values alike.
    assert covariance.combined(ratio_weights(covariance), ["sound speed"]).uncertainty == pytest.approx(0, abs=1e-15)
    difference = np.zeros(covariance.phasor_m.shape, np.complex128)
    difference[:2, 0] = [1, -1]
    assert covariance.combined(difference, ["speckle"]).covariance[0, 0] > 0
    noise = covariance.combined(difference, ["noise"])
    pair = [by_hand_m2(shot, shot, ("noise",))[0, :, 0] for shot in shots()[:2]]
    np.testing.assert_allclose(noise.covariance, pair[0] + pair[1])
    # Welch-Satterthwaite of two independent variances with 9 degrees of freedom each.
    variances = np.array([np.diag(matrix) for matrix in pair])
    np.testing.assert_allclose(noise.degrees_of_freedom, variances.sum(axis=0) ** 2 / (variances**2 / 9).sum(axis=0))
    one_shot = covariance.combined(ratio_weights(covariance), ["noise"])
    np.testing.assert_allclose(one_shot.degrees_of_freedom, NOISE_FREEDOM)
    # Student's t at 9 degrees of freedom, from tables.
    np.testing.assert_allclose(one_shot.interval_95, 2.2622 * one_shot.uncertainty, rtol=1e-4)


def test_without_influences_no_covariance_is_stated(result: Result, tmp_path: Path) -> None:
    without = replace(result, shots=tuple(replace(shot, influences=()) for shot in result.shots))
    with pytest.raises(ValueError, match=r"holds no covariance: influences of its 3 shots exceed 200 MB"):
        without.covariance()
    write_result(tmp_path / "without.h5", without)
    with pytest.raises(StoreError, match="no covariance can be read"):
        hpe.read_covariance(tmp_path / "without.h5")
    assert "influence_m" not in without.to_xarray()


def test_wrong_sources_and_weights_are_named_with_the_right_ones() -> None:
    with pytest.raises(ValueError, match=r"called nose.*noise, speckle, sound speed, aliasing, beam averaging"):
        covariance_of([shots()]).matrix_m2(["nose"])
    with pytest.raises(ValueError, match=r"shape \(2,\), values \(3, 3\).*one weight for each shot and frequency"):
        covariance_of([shots()]).combined(np.array([1.0, -1.0]))


def test_gtc_propagates_the_same_covariance_and_reads_it_back_from_an_archive(result: Result) -> None:
    """GTC, of the Measurement Standards Laboratory of New Zealand, computes covariance and degrees of freedom."""
    covariance, numbers = result.covariance(), result.to_gtc()
    logarithm = GTC.log(numbers[0][1] / numbers[0][0])
    combined = covariance.combined(ratio_weights(covariance))
    np.testing.assert_allclose(np.reshape(GTC.variance(logarithm), (2, 2)), combined.covariance, rtol=1e-9)
    real = GTC.log(GTC.magnitude(numbers[0][1] / numbers[0][0]))
    assert GTC.dof(real) == pytest.approx(combined.degrees_of_freedom[0], rel=1e-6)
    archive = GTC.persistence.Archive()
    archive.add(first=numbers[0][0], other=numbers[2][1])
    first, other = GTC.persistence.loads_json(GTC.persistence.dumps_json(archive)).extract("first", "other")
    stored = np.reshape(GTC.get_covariance(first, other), (2, 2))
    np.testing.assert_allclose(stored, covariance.matrix_m2()[0, 0, :, 2, 1], rtol=1e-9)


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Result:
    """A measured result whose shots are those of ``shots``."""
    run = hpe.measure(hpe.load_scene("table-1"), path=tmp_path_factory.mktemp("covariance") / "run.h5")
    return replace(run.estimate(), shots=shots())


def test_the_result_file_holds_the_covariance(result: Result, tmp_path: Path) -> None:
    path, covariance = tmp_path / "run.coherent.h5", result.covariance()
    write_result(path, result)
    assert verify(path).as_dict()["sound"]
    stored = hpe.read_covariance(path)
    for name in Covariance.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(stored, name), getattr(covariance, name))
    with xarray.open_dataset(path, group="covariance", engine="h5netcdf") as dataset:
        assert dict(dataset.influence_m.sizes)["frequency"] == FREQUENCIES
        assert dataset.influence_m.units == dataset.phasor_m.units == "m"
    dataset = result.to_xarray()
    noise = dataset.influence_m[:, :, dataset.source.values == "noise"]
    np.testing.assert_allclose(
        np.einsum("sfvp,sgvq->sfpgq", noise, noise),
        np.einsum("sfpsgq->sfpgq", covariance.matrix_m2(["noise"])),
    )


def test_a_file_without_covariance_is_refused_with_a_remedy(result: Result, tmp_path: Path) -> None:
    write_result(tmp_path / "old.h5", result)
    with h5py.File(tmp_path / "old.h5", "r+") as file:
        del file["covariance"]
    with pytest.raises(StoreError, match=r"no covariance can be read.*hpe-rig process"):
        hpe.read_covariance(tmp_path / "old.h5")
