"""Shots whose echoes exceed the digitizer's range."""

from __future__ import annotations

from pathlib import Path

import pytest

import hpe_rig as hpe
from drivers.interfaces import InstrumentError
from hpe_rig.processing import shot_fit


def test_a_shot_with_every_record_at_full_scale_is_not_trusted_and_gives_no_moduli(tmp_path: Path) -> None:
    scene = hpe.load_scene("table-1").with_({"acquisition.input_range_v": 0.02})
    with pytest.raises(InstrumentError, match="all 101 records of shot 1 reach full scale"):
        hpe.measure(scene, path=tmp_path / "run.h5")
    run = hpe.open_run(tmp_path / "run.h5")
    (shot,) = run.estimate().shots
    assert shot.untrusted == "every record reaches the digitizer's full scale in the gate"
    with pytest.raises(ValueError, match="every record reaches"):
        shot_fit(run.scene, run.plan.shots[0], run.stored, "coherent")
