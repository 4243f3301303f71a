"""What a scene does not need, and why: it costs nothing, and ``hpe-rig check`` says so."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from hpe_rig.bench import BenchFile
from hpe_rig.scene import Scene


@dataclass(frozen=True, slots=True)
class LeftOut:
    """Something this scene does not need, and why."""

    what: str
    why: str


def left_out(scene: Scene, bench: BenchFile) -> list[LeftOut]:
    """Return what a measurement of ``scene`` on ``bench`` opens, draws and sums nothing for, with the reasons."""
    out: list[LeftOut] = []
    if scene.excitation is None:
        out.append(LeftOut("generators burst_train and toneburst", "the scene has no [excitation]"))
    if scene.beams is None:
        out.append(LeftOut("predicted beam averaging", "the scene has no [beams]"))
    if not bench.simulated:
        out.append(
            LeftOut("the twin", "the bench is real" + (", [simulation] is not read" if scene.simulation else ""))
        )
        return out
    simulation = scene.simulation or {}
    out += _simulation_left_out(simulation)
    if "specimen" not in simulation:
        motion = "the motion is prescribed" if "motion" in simulation else "nothing moves"
        out.append(LeftOut("specimen response", f"{motion}: the scene has no [simulation.specimen]"))
    return out


def _simulation_left_out(simulation: Mapping[str, Any]) -> Iterator[LeftOut]:
    chain = simulation.get("receive_chain")
    if chain is None:
        yield LeftOut("receive chain", "the scene has no [simulation.receive_chain]: filters and switch are ideal")
    noise = "receiver.snr_db" if chain is None else "receive_chain.noise_v_per_sqrt_hz"
    # A preset of the chain brings its noise along.
    if noise.split(".")[1] not in simulation.get(noise.split(".")[0], {}) and "preset" not in (chain or {}):
        yield LeftOut("receiver noise", f"simulation.{noise} is absent")
    if not simulation.get("instruments", {}).get("trigger_jitter_s"):
        yield LeftOut("trigger jitter", "simulation.instruments.trigger_jitter_s is absent or 0")
