"""Checks of what pulses can track on the twin: an echo the digitizer sees, in time, that moves less than it repeats.

Nobody knows these of a real specimen beforehand; of a twin they are declared, and beyond them an estimate is a number
without a meaning.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from hpe_rig.bench import BenchFile, TwinDeclaration, twin_of
from hpe_rig.plan.checks.check_result import CheckResult, Level, in_hz
from hpe_rig.plan.checks.simulation import gate_in_twin_m
from hpe_rig.plan.shots import Plan, Shot
from hpe_rig.scene import Scene

LEAST_STEPS, FEW_STEPS = 2.0, 8.0
"""Root mean square of an echo in steps of the digitizer: below the first it is lost, below the second distorted."""
LEAST_SNR_DB, POOR_SNR_DB = -15.0, 0.0
MOST_PULSES = 4000
"""Pulses whose motion is looked at: of a longer train the first, in which the motion has long become steady."""


def trackable(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield why the twin's echoes or motion cannot be tracked; nothing where they can."""
    twin = twin_of(scene) if bench.simulated else None
    if twin is None:
        return
    off_m = abs(gate_in_twin_m(scene, bench, twin, plan)[0] - twin.focus_depth_m)
    off_m = max(0.0, off_m - scene.acquisition.gate_length_m / 2)
    yield from _echo(scene, bench, plan.shots[0], twin, off_m)
    yield from _jitter(scene, twin)
    yield from _steps(scene, plan, twin)


def _echo(scene: Scene, bench: BenchFile, shot: Shot, twin: TwinDeclaration, off_m: float) -> Iterator[CheckResult]:
    """Yield whether the resting echo, ``off_m`` from the focus, ends in time and is above digitizer step and noise."""
    if not twin.has_echoes:
        text = "simulation.scatterers has neither scatterers (per_cell = 0) nor reflectors: nothing echoes"
        yield CheckResult("echo level", "refused", text, "per_cell above 0, such as 11")
        return
    pulse_s, period_s = twin.echo_pulse_s(scene.tracking.carrier_hz), 1 / scene.tracking.pulse_rate_hz
    if pulse_s > period_s:
        text = f"simulation.scatterers make an echo {pulse_s * 1e3:.3g} ms long, from one tracking pulse "
        text += f"to the next are {period_s * 1e3:.3g} ms"
        yield CheckResult(
            "echo length",
            "refused",
            text,
            "a larger bandwidth, a shorter measured_pulse, or a lower tracking.pulse_rate_hz",
        )
    if twin.has_receive_chain:
        # What reaches the digitizer is then the filters' and amplifiers' doing.
        return
    pulser = shot.tracking_pulser
    echo_v = twin.echo_v(pulser.amplitude_vpp, pulser.cycles, pulser.carrier_hz, off_m)
    step_v = 2 * scene.acquisition.input_range_v / 2**bench.digitizer.board_model.code_bits
    if echo_v < FEW_STEPS * step_v:
        text = f"the twin's echo of {echo_v * 1e6:.3g} uV rms is {echo_v / step_v:.2g} steps of the digitizer, "
        text += f"{step_v * 1e6:.3g} uV each at acquisition.input_range_v = {scene.acquisition.input_range_v:g} V"
        remedy = "a larger simulation.receiver.echo_rms_v, less attenuation, or a smaller acquisition.input_range_v"
        yield CheckResult("echo level", _level(echo_v < LEAST_STEPS * step_v), text, remedy)
    noise_v = twin.noise_v
    snr_db = math.inf if not noise_v or not echo_v else 20 * math.log10(echo_v / noise_v)
    if snr_db < POOR_SNR_DB:
        text = f"the twin's echo lies {-snr_db:.3g} dB below its noise: single pulses tell little, and are ambiguous"
        remedy = "a larger simulation.receiver.snr_db or generators.tracking_pulser.amplitude_vpp"
        yield CheckResult("echo in noise", _level(snr_db < LEAST_SNR_DB), text, remedy)


def _jitter(scene: Scene, twin: TwinDeclaration) -> Iterator[CheckResult]:
    """Yield whether jitter from pulse to pulse stays below a quarter of the carrier's period, beyond which it wraps."""
    wrap_s = 0.5 / scene.tracking.carrier_hz
    shown = f"half a period of tracking.carrier_hz = {in_hz(scene.tracking.carrier_hz)} is {wrap_s * 1e9:.3g} ns"
    for key, jitter_s in twin.jitters_s.items():
        # The difference of two pulses has sqrt(2) times the jitter of each; beyond three of these it rarely goes.
        step_s = math.sqrt(2) * jitter_s
        if 3 * step_s > wrap_s:
            text = f"simulation.instruments.{key} = {jitter_s:g} s shifts a pulse against the next by "
            text += f"{step_s * 1e9:.3g} ns rms, {shown}: the echo's phase is ambiguous"
            yield CheckResult("jitter", _level(step_s > wrap_s), text, f"{key} below {wrap_s / 4.3:.2g} s")


def _steps(scene: Scene, plan: Plan, twin: TwinDeclaration) -> Iterator[CheckResult]:
    """Yield whether the motion from one pulse to the next is less than a quarter wavelength."""
    quarter_m = twin.sound_speed_m_per_s / (4 * scene.tracking.carrier_hz)
    shot = max(plan.shots, key=lambda each: (each.timeline.burst_length_s, each.force_fraction or 0.0))
    bursts = shot.toneburst
    drive = None if bursts is None else (bursts.carrier_hz, bursts.amplitude_vpp)
    time_s = shot.timeline.sensing_s[:MOST_PULSES]
    moved_m = twin.displacement_m(time_s, shot.timeline.burst_onset_s, shot.timeline.burst_length_s, drive)
    step_m = float(np.abs(np.diff(moved_m)).max(initial=0.0))
    if not step_m < quarter_m:
        text = f"the twin moves by up to {step_m * 1e6:.3g} um from a pulse to the next, a quarter wavelength is "
        text += f"{quarter_m * 1e6:.3g} um: which way it went is ambiguous"
        remedy = "less force or motion, a faster tracking.pulse_rate_hz, or a lower tracking.carrier_hz"
        yield CheckResult("motion between pulses", "refused", text, remedy)


def _level(refused: bool) -> Level:
    return "refused" if refused else "warning"
