"""Omissions: parts that a scene does not need, with reasons; they cost nothing, and ``hpe-rig check`` lists them."""

from __future__ import annotations

from collections.abc import Iterator

from hpe_rig.bench import BenchFile, TwinDeclaration, twin_of
from hpe_rig.scene import Scene, properties_of

Omission = tuple[str, str]
"""A part that a scene does not need, and the reason."""


def omissions(scene: Scene, bench: BenchFile) -> list[Omission]:
    """Return the instruments, random draws and corrections that ``scene`` on ``bench`` does not need."""
    omitted: list[Omission] = []
    if scene.excitation is None:
        omitted.append(("generators burst_train and toneburst", "the scene has no [excitation]"))
    if scene.excitation is not None and (reason := reason_without_prior(scene)):
        effect = "only the pulses separate the tonebursts' other harmonics from the wanted ones"
        if scene.without_prior is None:
            effect += " in the tracked motion; the peak is corrected by the prior"
        omitted.append(("prior of media", f"{reason}: {effect}"))
    if scene.beams is None:
        reason = "the scene has no [beams]" if scene.sphere is None else "the [sphere] moves as a whole"
        omitted.append(("predicted beam averaging", reason))
    if bench.simulated:
        if scene.processing.drift == "linear":
            reason = 'processing.drift = "linear" gives the motion at the first pulse, true values are means'
            omitted.append(("comparison with true values", f"{reason} over the window"))
        return [*omitted, *_omitted_by_twin(twin_of(scene))]
    if bench.recording is not None:
        return [*omitted, ("instruments", "the records were imported")]
    ignored = ", [simulation] serves predictions only" if scene.simulation is not None else ""
    return [*omitted, ("the twin", f"the bench is real{ignored}")]


def reason_without_prior(scene: Scene) -> str | None:
    """Return why the other harmonics are fitted without the prior of media; None if the prior applies."""
    processing = scene.processing
    if properties_of(processing.estimator).velocity_chain:
        return f'processing.estimator = "{processing.estimator}", which takes none'
    if processing.harmonic == "least_squares":
        return 'processing.harmonic = "least_squares"'
    return "process_noise is not 0" if processing.process_noise else scene.without_prior


def _omitted_by_twin(twin: TwinDeclaration | None) -> Iterator[Omission]:
    chain = twin is not None and twin.settings.receive_chain is not None
    if not chain:
        yield ("receive chain", "the scene has no [simulation.receive_chain]: filters and switch are ideal")
    if twin is None or not twin.has_noise:
        key = "receive_chain.noise_v_per_sqrt_hz" if chain else "receiver.snr_db"
        yield ("receiver noise", f"simulation.{key} is absent")
    if twin is None or not twin.settings.instruments.trigger_jitter_s:
        yield ("trigger jitter", "simulation.instruments.trigger_jitter_s is absent or 0")
    if twin is None or twin.settings.specimen is None:
        motion = "the motion is prescribed" if twin is not None and twin.prescribed else "nothing moves"
        yield ("specimen response", f"{motion}: the scene has no [simulation.specimen]")
