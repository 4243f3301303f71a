"""On the real bench named by HPE_RIG_BENCH: every instrument answers, is programmed, and ends off. Nothing is fired."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from hpe_rig.bench.opening import open_bench
from hpe_rig.measurement.setup import prepare

pytestmark = pytest.mark.hardware


def test_every_instrument_takes_and_returns_its_settings_and_ends_off() -> None:
    setup = prepare("bovine-muscle", Path(os.environ["HPE_RIG_BENCH"]))
    assert not setup.bench.bench.simulated
    shot = setup.plan.shots[0]
    with open_bench(setup.scene.scene, setup.bench.bench, setup.plan.roles) as bench:
        assert bench.world is None
        assert bench.burst_train is not None
        assert bench.toneburst is not None
        assert shot.burst_train is not None
        assert shot.toneburst is not None
        bench.master.configure(shot.master)
        bench.burst_train.configure(shot.burst_train)
        bench.toneburst.configure(shot.toneburst)
        bench.tracking_train.configure(shot.tracking_train)
        bench.tracking_pulser.configure(shot.tracking_pulser)
        bench.digitizer.configure(shot.capture)
        assert set(bench.verify()) == set(setup.plan.roles)
