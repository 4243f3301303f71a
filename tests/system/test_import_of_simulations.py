"""Echoes of public simulators, imported through the command line, give the motion of their scatterers within u."""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

from hpe_rig.cli.app import app

# PyMUST's docstrings hold "\\m", which Python warns of when it compiles them: until 3.11 by another name.
pytestmark = [
    pytest.mark.external,
    pytest.mark.filterwarnings("ignore:invalid escape sequence '.m':SyntaxWarning"),
    pytest.mark.filterwarnings("ignore:invalid escape sequence '.m':DeprecationWarning"),
]

PULSES, PULSE_RATE_HZ, SPEED, RATE_HZ, CARRIER_HZ = 40, 4000.0, 1540.0, 20e6, 2.72e6
ELEMENTS, DEPTH_M = 16, 50e-3
AMPLITUDE_M, MOVED_HZ, PHASE_RAD = 2e-6, 300.0, 0.5
SCENE = """
title = "Echoes of a simulator"
[tracking]
[acquisition]
gate_depth_m = 50e-3
gate_length_m = 4e-3
[processing]
frequencies_hz = [300.0]
"""


def scatterers() -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    rng = np.random.default_rng(7)
    return rng.uniform(-2e-3, 2e-3, 80), rng.uniform(44e-3, 56e-3, 80), rng.normal(size=80)


def moved_m() -> NDArray[np.float64]:
    """Return how far all scatterers are away when each pulse senses them, 50 mm deep."""
    sensed_s = np.arange(PULSES) / PULSE_RATE_HZ + DEPTH_M / SPEED
    return np.asarray(AMPLITUDE_M * np.sin(2 * np.pi * MOVED_HZ * sensed_s + PHASE_RAD))


def pymust() -> NDArray[np.float64]:
    """Return channel data (pulse, sample, element) of PyMUST's SIMUS, a plane wave out of 16 elements of a P4-2v."""
    must = importlib.import_module("pymust")
    known = must.getparam("P4-2v")
    known.Nelements, known.fs, known.c, known.attenuation = ELEMENTS, RATE_HZ, SPEED, 0.0
    known.TXapodization = np.ones(ELEMENTS)
    x, z, strength = scatterers()
    each = [must.simus(x, z + u, strength, np.zeros((1, ELEMENTS)), known)[0] for u in moved_m()]
    length = min(rf.shape[0] for rf in each)
    return np.stack([rf[:length] for rf in each])


def fastsimus() -> NDArray[np.float64]:
    """Return the same of FastSIMUS, another program by the same equations."""
    simus = importlib.import_module("fast_simus")
    probe = simus.TransducerParams(
        freq_center=CARRIER_HZ, pitch=300e-6, kerf=50e-6, n_elements=ELEMENTS, bandwidth=0.74
    )
    x, z, strength = scatterers()
    delays = np.zeros(ELEMENTS)
    each = [simus.simus(np.stack([x, z + u], -1), strength, delays, probe, fs=RATE_HZ).rf for u in moved_m()]
    length = min(rf.shape[0] for rf in each)
    return np.stack([np.asarray(rf[:length]) for rf in each])


@pytest.mark.parametrize("simulated", [pymust, fastsimus])
def test_simulated_channel_data_give_the_motion_of_their_scatterers(
    simulated: Callable[[], NDArray[np.float64]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("scene.toml").write_text(SCENE, encoding="utf-8")
    np.savez("rf.npz", rf=simulated(), fs=RATE_HZ, fc=CARRIER_HZ, prf=PULSE_RATE_HZ, c=SPEED)
    # Every element is a line; their mean is what a plane wave back to all of them gives.
    words = "import rf.npz --scene scene.toml -o run.h5 --lines mean --set axes=pulse,sample,line"
    made = CliRunner().invoke(app, words.split())
    assert made.exit_code == 0, made.output
    assert "sample_rate_hz = 2e+07, from 'fs' of the file" in made.output
    done = CliRunner().invoke(app, ["process", "run.h5", "--json"])
    (found,) = json.loads(done.output)["shots"][0]["estimates"]
    u_m = np.sqrt(sum(part["amplitude_m"] ** 2 for part in found["components"]))
    # The simulator's sound speed is the scene's, whose uncertainty is most of u; 16 elements see a scatterer up to 3.6
    # degrees off their axis, which takes 0.1 % of its motion along the way.
    assert found["amplitude_m"] == pytest.approx(AMPLITUDE_M, abs=u_m)
    assert found["amplitude_m"] == pytest.approx(AMPLITUDE_M, rel=0.002)
    assert found["phase_rad"] == pytest.approx(PHASE_RAD, abs=2e-3)
