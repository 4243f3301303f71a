"""Checks of a simulated bench: a specimen in the gate, bench and medium as declared, and no motion that aliases."""

from __future__ import annotations

from collections.abc import Iterator

from hpe_rig.bench import BenchFile, TwinDeclaration, contradictions, twin_of
from hpe_rig.plan.checks.check_result import CheckResult
from hpe_rig.plan.shots import Plan
from hpe_rig.scene import Scene


def simulation(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield whether the twin has a specimen, in the gate, and is otherwise what the scene says and assumes."""
    twin = twin_of(scene) if bench.simulated else None
    if twin is None:
        return
    if scene.default_specimen is not None:
        text = f"{scene.default_specimen}, in focus at the gate: the scene has no [simulation]"
        yield CheckResult("simulated specimen", "passed", text)
    assumed = scene.acquisition.sound_speed_m_per_s
    if twin.sound_speed_m_per_s != assumed:
        text = f"simulation.sound_speed_m_per_s = {twin.sound_speed_m_per_s:g} m/s, "
        text += f"the gate assumes acquisition.sound_speed_m_per_s = {assumed:g} m/s"
        yield CheckResult("sound speed", "warning", text, "equal values, unless the mismatch is what is studied")
    for key, declared, simulated in contradictions(scene):
        text = f"{key} = {declared}, the twin simulates {simulated}: what is predicted and corrected is another bench's"
        yield CheckResult("declared", "warning", text, "equal values, unless the mismatch is what is studied")
    beams = scene.beams if scene.excitation is not None else None
    if beams is not None and beams.excitation_scan is None and twin.settings.beams.field == "measured":
        diameter_m = beams.transducer_diameter_m
        shape = "a Gaussian" if diameter_m is None else f"an even bowl of {diameter_m * 1e3:g} mm"
        text = (
            f"the twin's push is a hydrophone's scan, moduli and predictions take {shape} in its place: of bowls that "
        )
        text += "move unevenly mu1 is then off by up to 4 % and mu2 by 6 % from five places, which is not in u"
        yield CheckResult("declared", "warning", text, "beams.excitation_scan, the same scan; docs/how-to/moduli.md")
    if (bench.digitizer.system_id, bench.digitizer.board_id) != (1, 1):
        text = f"digitizer.system_id = {bench.digitizer.system_id}, board_id = {bench.digitizer.board_id}"
        yield CheckResult("simulated board", "refused", f"{text}: the simulated board is 1 of system 1", "1 for both")
    capture = plan.shots[0].capture
    held = twin.max_records(bench, capture.record_samples)
    if capture.record_count > held:
        text = f"the twin's board holds {held:g} of {capture.record_count} records of {capture.record_samples} samples"
        remedy = "more simulation.instruments.samples_per_channel, as the bench file says of the board"
        yield CheckResult("simulated board", "refused", text, remedy)
    yield from _focus(scene, bench, twin, plan)
    yield from _unwanted_motion(scene, twin, plan)


def _focus(scene: Scene, bench: BenchFile, twin: TwinDeclaration, plan: Plan) -> Iterator[CheckResult]:
    """Yield whether the gate, at the depth that its echoes really come from, holds the focus and anything at all."""
    acquisition = scene.acquisition
    depth_m, later_m = gate_in_twin_m(scene, bench, twin, plan)
    off_m, half_m = abs(depth_m - twin.focus_depth_m), acquisition.gate_length_m / 2
    if off_m <= half_m * (1 + 1e-9):
        return
    text = f"the gate's middle lies {depth_m * 1e3:.4g} mm deep in the twin's medium "
    text += f"(acquisition.gate_depth_m = {acquisition.gate_depth_m:g} m), its focus at simulation.beams.focus_depth_m "
    text += f"= {twin.focus_depth_m:g} m"
    if abs(later_m) > half_m:
        text += f" (latencies of simulation.instruments, not those of the bench file: {later_m * 1e3:.4g} mm)"
    remedy = "equal depths, sound speeds and latencies, unless the offset is what is studied"
    pulse_m = scene.tracking.cycles / scene.tracking.carrier_hz * acquisition.sound_speed_m_per_s / 2
    declared_m = None if scene.beams is None else scene.beams.pulse_length_m
    if off_m > twin.echo_reach_m + half_m + (declared_m or pulse_m):
        text += f": nothing echoes more than {twin.echo_reach_m * 1e3:g} mm from the focus, the gate would hold noise"
        yield CheckResult("gate in focus", "refused", text, remedy)
        return
    text += ": the gate does not hold the focus, so echo, motion and beams in it are not those assumed"
    yield CheckResult("gate in focus", "warning", text, remedy)


def gate_in_twin_m(scene: Scene, bench: BenchFile, twin: TwinDeclaration, plan: Plan) -> tuple[float, float]:
    """Return how deep in the twin's medium the gate's middle lies, and how much of that its latencies make.

    The gate is a time after the pulse: another sound speed moves it in depth, other latencies do too.
    """
    acquisition, capture = scene.acquisition, plan.shots[0].capture
    later_m = twin.depth_shift_m(bench, capture.trigger_delay_samples / capture.sample_rate_hz)
    return scene.gate_depth_m * twin.sound_speed_m_per_s / acquisition.sound_speed_m_per_s + later_m, later_m


def _unwanted_motion(scene: Scene, twin: TwinDeclaration, plan: Plan) -> Iterator[CheckResult]:
    """Yield which prescribed motion the pulses cannot tell from a wanted frequency."""
    rate_hz = scene.tracking.pulse_rate_hz
    train_s = plan.shots[0].capture.record_count / rate_hz - scene.processing.window_start_s
    apart_hz = 1 / min(scene.processing.window_length_s or train_s, train_s) if train_s > 0 else 0.0
    for moving_hz, amplitude_m in twin.prescribed:
        seen_hz = abs(moving_hz - rate_hz * round(moving_hz / rate_hz))
        near = [
            hz for hz in scene.wanted_frequencies_hz if abs(seen_hz - hz) < apart_hz * (1 - 1e-9) and hz != moving_hz
        ]
        if not near or amplitude_m == 0:
            continue
        text = f"[[simulation.motion]] moves {amplitude_m * 1e9:g} nm at {moving_hz:g} Hz, which "
        text += (
            f"tracking.pulse_rate_hz = {rate_hz:g} Hz shows at {seen_hz:g} Hz, less than {apart_hz:.3g} Hz (one over "
        )
        text += f"the window) from the wanted {', '.join(f'{hz:g}' for hz in near)} Hz: amplitude and phase hold both"
        remedy = "another pulse rate, processing.frequencies_hz with that frequency as well, or a longer window"
        yield CheckResult("motion aliased", "warning", text, remedy)
