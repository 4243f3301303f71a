"""The ensemble of media: motion of its members as the twin moves, between nodes, places and forces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hpe_rig.medium import (
    BeamWidths,
    HarmonicMedium,
    TrackedRegion,
    aperture_force,
    medium_ensemble,
    shear_motion,
)
from hpe_rig.medium.ensemble import prior_modulus
from hpe_rig.medium.focal_field import focal_displacement
from sim_backend.motion.specimen import frequency_response
from sim_backend.settings import Specimen

FORCE_M = (0.17e-3, 0.17e-3, 1.80e-3)
TRACKING_M = (0.078e-3, 0.078e-3, 0.83e-3)
DEPTH_M = 0.3e-3
BEAMS = BeamWidths(FORCE_M, TRACKING_M, DEPTH_M)
RATE_HZ = 100.0


def test_the_ensembles_displacement_is_the_twins() -> None:
    specimen = Specimen(shear_modulus_pa=9e3, shear_viscosity_pa_s=2.0)
    frequency_hz = np.geomspace(50, 40e3, 40)
    modulus_pa = 9e3 + 2j * np.pi * frequency_hz * 2.0
    shear_k2 = 1000.0 * (2 * np.pi * frequency_hz) ** 2 / modulus_pa
    result = (
        focal_displacement(shear_k2[None], np.array([FORCE_M[0] ** 2]), np.array([FORCE_M[2] ** 2]))[0][0] / modulus_pa
    )
    truth = frequency_response(specimen, FORCE_M, frequency_hz)
    np.testing.assert_allclose(result / result[0], truth / truth[0], rtol=5e-4)


def test_the_displacements_slope_is_its_change_with_the_width() -> None:
    """Central differences of 1e-3: their own error is of the order of its square."""
    frequency_hz = np.geomspace(50, 40e3, 40)
    modulus_pa = np.array([1e3 + 2j * np.pi * frequency_hz * 0.005, 60e3 + 2j * np.pi * frequency_hz * 15.0])
    shear_k2, lateral, axial = 1000.0 * (2 * np.pi * frequency_hz) ** 2 / modulus_pa, FORCE_M[0] ** 2, FORCE_M[2] ** 2

    def at_width(scale: float) -> NDArray[np.complex128]:
        return focal_displacement(shear_k2, np.full(2, scale * lateral), np.full(2, axial), 96)[0]

    value, slope = focal_displacement(shear_k2, np.full(2, lateral), np.full(2, axial), 96)
    np.testing.assert_array_equal(value, at_width(1.0))
    change = (at_width(1.001) - at_width(0.999)) / 2e-3
    assert np.abs(lateral * slope / change - 1).max() < 1e-5


def test_between_its_nodes_a_medium_is_interpolated() -> None:
    coarse = medium_ensemble(BEAMS, 100.0, 4e4)
    fine = medium_ensemble(BEAMS, 100.0, 3.9e4)
    between = coarse.tracked @ coarse.interpolation(fine.node_hz).T
    largest = np.abs(coarse.tracked).max(axis=1, keepdims=True)
    assert np.abs((between - fine.tracked) / largest).max() < 3e-4


def test_a_force_that_is_no_gaussian_moves_the_ensemble_as_it_moves_media() -> None:
    beams = replace(BEAMS, force_width_m=(0.34e-3, 0.34e-3, 3.6e-3), width_log_sd=0.0)
    force = aperture_force(45e-3, 70e-3, 3e6, 1540.0, 0.5)
    plain, shaped = (medium_ensemble(each, RATE_HZ, 4e4) for each in (beams, replace(beams, force=force)))
    # what is tracked of the peak stays that of the Gaussian
    np.testing.assert_allclose(shaped.peak / shaped.tracked, plain.peak / plain.tracked, rtol=1e-9)
    region, members = (
        TrackedRegion(np.zeros(1), 0.0, TRACKING_M[0] ** 2 / 2, DEPTH_M**2),
        np.flatnonzero(plain.voigt)[:4],
    )
    for member in (*members, 3):
        modulus_pa = prior_modulus(np.asarray(2j * np.pi * plain.node_hz), 240)[member]
        wanted_columns = shear_motion(HarmonicMedium(plain.node_hz, modulus_pa), force, region).value[:, 0]
        ratio = shaped.tracked[member] / wanted_columns
        assert np.abs(ratio / ratio.mean() - 1).max() < 4e-3


def test_ensembles_of_all_places_at_once_are_those_of_one_at_a_time() -> None:
    places_m = (1e-9, 1e-3, 6e-3)
    beams = [replace(BEAMS, lateral_offset_m=lateral_m) for lateral_m in places_m]
    alone = [medium_ensemble(each, 100.0, 2000.0) for each in beams]
    together = [medium_ensemble(replace(each, offsets_of_joint_fit_m=places_m), 100.0, 2000.0) for each in beams]
    # both good to 1e-5 of the largest displacement, which is that of the focus
    allowed = 2e-5 * np.abs(alone[0].peak)
    for one, other in zip(alone, together, strict=True):
        assert (np.abs(one.tracked - other.tracked) < allowed).all()
        assert (np.abs(one.peak - other.peak) < allowed).all()


def test_off_axis_the_ensemble_is_interpolated_to_1e_3_of_the_motion() -> None:
    beams, harmonic = replace(BEAMS, lateral_offset_m=2.25e-3), np.arange(81, 401)
    ensemble = medium_ensemble(beams, RATE_HZ, 4e4)
    member = int(np.flatnonzero(ensemble.voigt)[1])
    # the same nodes alone, each harmonic for itself
    other = medium_ensemble(beams, RATE_HZ * 81, RATE_HZ * 81 * 2)
    assert other.harmonic_nodes == other.node_hz.size == 2
    between = (ensemble.tracked @ ensemble.interpolation(other.node_hz).T)[member]
    rms = np.sqrt(np.sum(np.abs(ensemble.tracked @ ensemble.interpolation(RATE_HZ * harmonic).T) ** 2, axis=1))[member]
    assert np.abs(between - other.tracked[member]).max() < 1e-3 * rms
