"""Checks of a simulated bench: a specimen in the gate, settings as declared, and no motion that aliases."""

from __future__ import annotations

from collections.abc import Iterator

from hpe_rig.bench import BenchFile, TwinDeclaration, contradictions, twin_of
from hpe_rig.plan.checks.check_result import CheckResult
from hpe_rig.plan.shots import Plan
from hpe_rig.scene import Scene

SIMULATED_BOARD = (1, 1)
"""System and number of the simulated digitizer."""


def simulation(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield whether the twin has a specimen in the gate and agrees with the settings of scene and bench."""
    twin = twin_of(scene) if bench.simulated else None
    if twin is None:
        return
    if scene.default_specimen is not None:
        text = f"{scene.default_specimen}, in focus at the gate: the scene has no [simulation]"
        yield CheckResult("simulated specimen", "passed", text)
    yield from _declared(scene, twin)
    yield from _board(bench, twin, plan)
    yield from _focus(scene, bench, twin, plan)
    yield from _aliased_motion(scene, twin, plan)


def _declared(scene: Scene, twin: TwinDeclaration) -> Iterator[CheckResult]:
    """Yield the settings of the scene that differ from those of the twin."""
    assumed_m_per_s = scene.acquisition.sound_speed_m_per_s
    remedy = "equal values, unless the mismatch is what is studied"
    if twin.sound_speed_m_per_s != assumed_m_per_s:
        text = f"simulation.sound_speed_m_per_s = {twin.sound_speed_m_per_s:g} m/s, "
        text += f"the gate assumes acquisition.sound_speed_m_per_s = {assumed_m_per_s:g} m/s"
        yield CheckResult("sound speed", "warning", text, remedy)
    for key, declared, simulated in contradictions(scene):
        text = f"{key} = {declared}, the twin simulates {simulated}: predictions and corrections apply to another bench"
        yield CheckResult("declared", "warning", text, remedy)
    beams = scene.beams if scene.excitation is not None else None
    if beams is not None and beams.excitation_scan is None and twin.settings.beams.field == "measured":
        diameter_m = beams.transducer_diameter_m
        shape = "a Gaussian" if diameter_m is None else f"an even bowl of {diameter_m * 1e3:g} mm"
        text = f"the twin's push is a hydrophone scan, moduli and predictions assume {shape} instead: for bowls that "
        text += "move unevenly mu1 is then off by up to 4 % and mu2 by 6 % from five offsets, which u does not include"
        remedy = "beams.excitation_scan, the same scan; docs/how-to/push-force.md"
        yield CheckResult("declared", "warning", text, remedy)


def _board(bench: BenchFile, twin: TwinDeclaration, plan: Plan) -> Iterator[CheckResult]:
    """Yield conflicts with the simulated digitizer: another board, too many records."""
    if (bench.digitizer.system_id, bench.digitizer.board_id) != SIMULATED_BOARD:
        text = f"digitizer.system_id = {bench.digitizer.system_id}, board_id = {bench.digitizer.board_id}"
        yield CheckResult("simulated board", "refused", f"{text}: the simulated board is 1 of system 1", "1 for both")
    capture = plan.shots[0].capture
    limit = twin.max_records(bench, capture.record_samples)
    if capture.record_count > limit:
        text = f"the twin's board holds {limit:g} of {capture.record_count} records of {capture.record_samples} samples"
        remedy = "more simulation.instruments.samples_per_channel, as the bench file says of the board"
        yield CheckResult("simulated board", "refused", text, remedy)


def _focus(scene: Scene, bench: BenchFile, twin: TwinDeclaration, plan: Plan) -> Iterator[CheckResult]:
    """Yield a conflict or warning if the gate, at the depth of its simulated echoes, misses the focus."""
    acquisition = scene.acquisition
    depth_m, shift_m = simulated_gate_depth_m(scene, bench, twin, plan)
    offset_m, half_m = abs(depth_m - twin.focus_depth_m), acquisition.gate_length_m / 2
    if offset_m <= half_m * (1 + 1e-9):
        return
    text = f"the gate's centre is {depth_m * 1e3:.4g} mm deep in the twin's medium "
    text += f"(acquisition.gate_depth_m = {acquisition.gate_depth_m:g} m), its focus at simulation.beams.focus_depth_m "
    text += f"= {twin.focus_depth_m:g} m"
    if abs(shift_m) > half_m:
        text += f" (latencies of simulation.instruments, not those of the bench file: {shift_m * 1e3:.4g} mm)"
    remedy = "equal depths, sound speeds and latencies, unless the offset is what is studied"
    # Echoes reach one pulse length beyond the last scatterer.
    cycles_m = scene.tracking.cycles / scene.tracking.carrier_hz * acquisition.sound_speed_m_per_s / 2
    pulse_m = (None if scene.beams is None else scene.beams.pulse_length_m) or cycles_m
    if offset_m > twin.echo_reach_m + half_m + pulse_m:
        text += f": nothing echoes more than {twin.echo_reach_m * 1e3:g} mm from the focus, the gate would hold noise"
        yield CheckResult("gate in focus", "refused", text, remedy)
    else:
        text += ": the gate does not hold the focus, so echo, motion and beams in it are not those assumed"
        yield CheckResult("gate in focus", "warning", text, remedy)


def simulated_gate_depth_m(scene: Scene, bench: BenchFile, twin: TwinDeclaration, plan: Plan) -> tuple[float, float]:
    """Return the depth of the gate's centre in the twin's medium, and the part of it due to latencies.

    The gate is a time after the pulse: another sound speed and other latencies move it in depth.
    """
    capture = plan.shots[0].capture
    shift_m = twin.depth_shift_m(bench, capture.trigger_delay_samples / capture.sample_rate_hz)
    speed_m_per_s = scene.acquisition.sound_speed_m_per_s
    return scene.gate_depth_m * twin.sound_speed_m_per_s / speed_m_per_s + shift_m, shift_m


def _aliased_motion(scene: Scene, twin: TwinDeclaration, plan: Plan) -> Iterator[CheckResult]:
    """Yield the prescribed motions that alias so near to a wanted frequency that the window cannot separate them."""
    rate_hz = scene.tracking.pulse_rate_hz
    train_s = plan.shots[0].capture.record_count / rate_hz - scene.processing.window_start_s
    resolution_hz = 1 / min(scene.processing.window_length_s or train_s, train_s) if train_s > 0 else 0.0
    for motion_hz, amplitude_m in twin.prescribed:
        alias_hz = abs(motion_hz - rate_hz * round(motion_hz / rate_hz))
        near = [
            f"{hz:g}"
            for hz in scene.wanted_frequencies_hz
            if abs(alias_hz - hz) < resolution_hz * (1 - 1e-9) and hz != motion_hz
        ]
        if not near or amplitude_m == 0:
            continue
        text = f"[[simulation.motion]] moves {amplitude_m * 1e9:g} nm at {motion_hz:g} Hz, which at "
        text += f"tracking.pulse_rate_hz = {rate_hz:g} Hz aliases to {alias_hz:g} Hz, less than {resolution_hz:.3g} Hz "
        text += f"(one over the window) from the wanted {', '.join(near)} Hz: amplitude and phase include both"
        remedy = "another pulse rate, processing.frequencies_hz with that frequency as well, or a longer window"
        yield CheckResult("motion aliased", "warning", text, remedy)
