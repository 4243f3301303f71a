"""Omissions: what a scene does not need, and why; it costs nothing, and ``hpe-rig check`` says so."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from hpe_rig.bench import BenchFile, TwinDeclaration, twin_of
from hpe_rig.scene import Scene, properties_of


@dataclass(frozen=True, slots=True)
class Omission:
    """Something this scene does not need, and why."""

    what: str
    why: str


def omissions(scene: Scene, bench: BenchFile) -> list[Omission]:
    """Return what a measurement of ``scene`` on ``bench`` opens, draws and sums nothing for, with the reasons."""
    out: list[Omission] = []
    if scene.excitation is None:
        out.append(Omission("generators burst_train and toneburst", "the scene has no [excitation]"))
    if scene.excitation is not None and (why := _without_prior(scene)):
        untold = "only the pulses tell the tonebursts' other harmonics from the wanted ones"
        if scene.without_prior is None:
            untold += " in what is tracked; the peak is corrected for what the prior tells"
        out.append(Omission("prior of media", f"{why}: {untold}"))
    if scene.beams is None:
        why = "the scene has no [beams]" if scene.sphere is None else "the [sphere] moves as a whole"
        out.append(Omission("predicted beam averaging", why))
    if bench.simulated:
        return [*out, *_omitted_of_twin(twin_of(scene))]
    if bench.recording is not None:
        return [*out, Omission("instruments", "the records were imported")]
    unread = ", [simulation] is not read" if scene.simulation is not None else ""
    return [*out, Omission("the twin", "the bench is real" + unread)]


def _without_prior(scene: Scene) -> str | None:
    """Return why other harmonics than the wanted are free instead of the prior's; None where the prior holds them."""
    processing = scene.processing
    if properties_of(processing.estimator).velocity_chain:
        return f'processing.estimator = "{processing.estimator}", which takes none'
    if processing.harmonic == "least_squares":
        return 'processing.harmonic = "least_squares"'
    return "process_noise is not 0" if processing.process_noise else scene.without_prior


def _omitted_of_twin(twin: TwinDeclaration | None) -> Iterator[Omission]:
    chain = twin is not None and twin.has_receive_chain
    if not chain:
        yield Omission("receive chain", "the scene has no [simulation.receive_chain]: filters and switch are ideal")
    if twin is None or not twin.has_noise:
        noise = "receive_chain.noise_v_per_sqrt_hz" if chain else "receiver.snr_db"
        yield Omission("receiver noise", f"simulation.{noise} is absent")
    if twin is None or not twin.trigger_jitter_s:
        yield Omission("trigger jitter", "simulation.instruments.trigger_jitter_s is absent or 0")
    if twin is None or not twin.has_specimen:
        motion = "the motion is prescribed" if twin is not None and twin.prescribed else "nothing moves"
        yield Omission("specimen response", f"{motion}: the scene has no [simulation.specimen]")
