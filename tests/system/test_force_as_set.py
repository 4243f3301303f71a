"""Force as the toneburst generator holds it: an instrument rounds what it is sent, and the result goes by the rest."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import pytest

from hpe_rig.measurement.run import record_run
from hpe_rig.measurement.setup import Setup
from hpe_rig.runs.run import open_run, process
from hpe_rig.store import read_snapshots

# Half the force asks for 0.70710678 Vpp; a 33250A holds 4 digits.
HELD_VPP = 0.7071


@pytest.fixture
def run_file(prepared: Callable[..., Setup], tmp_path: Path) -> Path:
    half = ("[excitation]", "[excitation]\nforce_fraction = [1.0, 0.5]")
    return record_run(prepared("bovine-muscle", half), tmp_path / "run.h5")


def test_half_the_force_runs_and_is_stated_as_it_was_set(run_file: Path) -> None:
    full, half = read_snapshots(run_file)
    assert full["toneburst"]["amplitude_vpp"] == 1.0
    assert half["toneburst"]["amplitude_vpp"] == pytest.approx(HELD_VPP, rel=1e-12)
    forces = [shot.force_fraction for shot in process(run_file).shots]
    assert forces == pytest.approx([1.0, HELD_VPP**2], rel=1e-12)
    assert forces[0] == 1.0
    assert [shot.force_fraction for shot in open_run(run_file).plan.shots] == forces
    with h5py.File(run_file) as file:
        assert file["records/force_set"][()].tolist() == forces
        assert file["records/force_fraction"][()].tolist() == [1.0, 0.5]
