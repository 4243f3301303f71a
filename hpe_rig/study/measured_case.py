"""Case of a study by whole measurements: a scene with one shot, and the seeds of its realisations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hpe_rig.measurement import Setup, prepare
from hpe_rig.scene import Estimator, Scene, with_default_specimen


@dataclass(frozen=True, slots=True)
class MeasuredCase:
    """One scene with one setting, without its seed, and its number of realisations."""

    key: str
    """Hash of everything that its numbers depend on; the name of its file."""
    stream: int
    """Entropy of its seeds."""
    scene: Scene
    estimators: tuple[Estimator, ...]
    scatterers: int
    noise: int
    standard_error_m: float | None
    corrected: bool
    """Whether the amplitude is corrected for beam averaging."""

    @property
    def batch_key(self) -> tuple[str, ...]:
        """Sort key of batches; measured cases share no computation."""
        return (self.key,)

    @property
    def cost(self) -> float:
        """Computing time relative to other measured cases."""
        return float(self.scatterers * self.noise)

    def seeded(self, draw: int) -> Scene:
        """Return the scene of a draw; each of its shots is one realisation of the noise."""
        seed = int(np.random.SeedSequence(self.stream, spawn_key=(draw,)).generate_state(1)[0])
        return self.scene.with_({"simulation.seed": seed, "acquisition.repeats": self.noise})


def one_shot(scene: Scene) -> Scene:
    """Return the scene with only its first force, burst length, pulse rate and window, measured once."""
    scene = with_default_specimen(scene).rates[0].windows[0].model_copy(update={"sweep": type(scene.sweep)()})
    values: dict[str, Any] = {"acquisition.repeats": 1}
    if scene.excitation is not None:
        values["excitation.force_fraction"] = [scene.excitation.force_fraction[0]]
        values["excitation.burst_length_s"] = [scene.excitation.burst_length_s[0]]
    return scene.with_(values)


def first_setup(case: MeasuredCase) -> Setup:
    """Return the planned measurement of the first draw; raise as ``prepare`` if it is impossible."""
    return prepare(case.seeded(0))
