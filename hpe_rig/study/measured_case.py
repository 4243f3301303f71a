"""Case of a study that is measured whole: a scene with one shot, and the seeds of its realisations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hpe_rig.measurement import Setup, prepare
from hpe_rig.processing import Estimator
from hpe_rig.scene import Scene, with_default_specimen


@dataclass(frozen=True, slots=True)
class MeasuredCase:
    """One scene with one setting, its seeds left open, and the realisations of it."""

    key: str
    """Hash of all that its numbers depend on; the name of its file."""
    stream: int
    """Entropy of its seeds."""
    scene: Scene
    estimators: tuple[Estimator, ...]
    scatterers: int
    noise: int
    standard_error_m: float | None
    corrected: bool
    """Whether the amplitude is the one corrected for the averaging of the beams."""

    @property
    def sharing(self) -> tuple[str, ...]:
        """What cases have in common that are computed together: these have nothing."""
        return (self.key,)

    @property
    def cost(self) -> float:
        """How long it takes beside others of its kind."""
        return float(self.scatterers * self.noise)

    def seeded(self, draw: int) -> Scene:
        """Return the scene of a draw, each of its shots a realisation of the noise."""
        seed = int(np.random.SeedSequence(self.stream, spawn_key=(draw,)).generate_state(1)[0])
        return self.scene.with_({"simulation.seed": seed, "acquisition.repeats": self.noise})


def one_shot(scene: Scene) -> Scene:
    """Return the scene with its first force, burst length, pulse rate and window alone, once."""
    scene = with_default_specimen(scene).rates[0].windows[0].model_copy(update={"sweep": type(scene.sweep)()})
    values: dict[str, Any] = {"acquisition.repeats": 1}
    if scene.excitation is not None:
        values["excitation.force_fraction"] = [scene.excitation.force_fraction[0]]
        values["excitation.burst_length_s"] = [scene.excitation.burst_length_s[0]]
    return scene.with_(values)


def first_setup(case: MeasuredCase) -> Setup:
    """Return the first draw's measurement, planned; raise as ``prepare`` for what cannot be measured."""
    return prepare(case.seeded(0))
