"""Checks of tracking on the twin: level, length and noise of the echo, jitter, and motion between pulses.

For a real specimen these are unknown in advance. A twin declares them, and beyond the limits estimates are meaningless.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from hpe_rig.bench import BenchFile, TwinDeclaration, twin_of
from hpe_rig.plan.checks.check_result import CheckResult, Level, in_hz
from hpe_rig.plan.checks.simulation import simulated_gate_depth_m
from hpe_rig.plan.shots import Plan, Shot
from hpe_rig.scene import Scene

MIN_STEPS, FEW_STEPS = 2.0, 8.0
"""Root-mean-square echo in steps of the digitizer: below the first it is lost, below the second distorted."""
MIN_SNR_DB, LOW_SNR_DB = -15.0, 0.0
"""Echo over noise of one pulse: below the first it is lost, below the second its phase is ambiguous at times."""
MAX_PULSES = 4000
"""Number of pulses in the computed motion: later in a train the motion is steady."""


def trackable(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield the reasons why the twin's echoes cannot be tracked."""
    twin = twin_of(scene) if bench.simulated else None
    if twin is None:
        return
    if not twin.has_echoes:
        text = "simulation.scatterers has neither scatterers (per_cell = 0) nor reflectors: nothing echoes"
        yield CheckResult("echo level", "refused", text, "per_cell above 0, such as 11")
    else:
        offset_m = abs(simulated_gate_depth_m(scene, bench, twin, plan)[0] - twin.focus_depth_m)
        yield from _echo_length(scene, twin)
        # With a receive chain the level at the digitizer depends on its filters and amplifiers.
        if twin.settings.receive_chain is None:
            nearest_m = max(0.0, offset_m - scene.acquisition.gate_length_m / 2)
            yield from _echo_level(bench, plan.shots[0], twin, nearest_m)
    yield from _jitter(scene, twin)


def _echo_length(scene: Scene, twin: TwinDeclaration) -> Iterator[CheckResult]:
    """Yield a conflict if the echo of a pulse lasts until the next pulse."""
    pulse_s, period_s = twin.echo_pulse_s(scene.tracking.carrier_hz), 1 / scene.tracking.pulse_rate_hz
    if pulse_s > period_s:
        text = f"simulation.scatterers make an echo {pulse_s * 1e3:.3g} ms long, from one tracking pulse "
        text += f"to the next are {period_s * 1e3:.3g} ms"
        remedy = "a larger bandwidth, or a lower tracking.pulse_rate_hz"
        yield CheckResult("echo length", "refused", text, remedy)


def _echo_level(bench: BenchFile, shot: Shot, twin: TwinDeclaration, focus_offset_m: float) -> Iterator[CheckResult]:
    """Yield whether the echo, ``focus_offset_m`` from the focus, is above the digitizer's step and the noise."""
    pulser, range_v = shot.tracking_pulser, shot.capture.input_range_v
    echo_v = twin.echo_v(pulser.amplitude_vpp, pulser.cycles, pulser.carrier_hz, focus_offset_m)
    # One code of the digitizer at this range.
    step_v = 2 * range_v / 2**bench.digitizer.board_model.code_bits
    if echo_v < FEW_STEPS * step_v:
        text = f"the twin's echo of {echo_v * 1e6:.3g} uV rms is {echo_v / step_v:.2g} steps of the digitizer, "
        text += f"{step_v * 1e6:.3g} uV each at acquisition.input_range_v = {range_v:g} V"
        remedy = "a larger simulation.receiver.echo_rms_v, less attenuation, or a smaller acquisition.input_range_v"
        yield CheckResult("echo level", _level(echo_v < MIN_STEPS * step_v), text, remedy)
    noise_v = twin.noise_v
    snr_db = math.inf if not noise_v or not echo_v else 20 * math.log10(echo_v / noise_v)
    if snr_db < LOW_SNR_DB:
        text = f"the twin's echo is {-snr_db:.3g} dB below its noise: the phase of single pulses is ambiguous"
        remedy = "a larger simulation.receiver.snr_db or generators.tracking_pulser.amplitude_vpp"
        yield CheckResult("echo in noise", _level(snr_db < MIN_SNR_DB), text, remedy)


def _jitter(scene: Scene, twin: TwinDeclaration) -> Iterator[CheckResult]:
    """Yield the jitters that can shift two pulses by half a period of the carrier, where the phase wraps."""
    wrap_s = 0.5 / scene.tracking.carrier_hz
    half_period = f"half a period of tracking.carrier_hz = {in_hz(scene.tracking.carrier_hz)} is {wrap_s * 1e9:.3g} ns"
    for key, jitter_s in twin.jitters_s.items():
        # The difference of two pulses has sqrt(2) times the jitter of one; it rarely exceeds three times that.
        difference_s = math.sqrt(2) * jitter_s
        if 3 * difference_s > wrap_s:
            text = f"simulation.instruments.{key} = {jitter_s:g} s shifts a pulse against the next by "
            text += f"{difference_s * 1e9:.3g} ns rms, {half_period}: the echo's phase is ambiguous"
            remedy = f"{key} below {wrap_s / 4.3:.2g} s"
            yield CheckResult("jitter", _level(difference_s > wrap_s), text, remedy)


def motion_between_pulses(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield a conflict if the twin's motion from one pulse to the next reaches a quarter wavelength."""
    twin = twin_of(scene) if bench.simulated else None
    if twin is None:
        return
    quarter_m = twin.sound_speed_m_per_s / (4 * scene.tracking.carrier_hz)
    # The shot with the longest tonebursts and the largest force moves most.
    shot = max(plan.shots, key=lambda item: (item.timeline.burst_length_s, item.force_fraction or 0.0))
    bursts = shot.toneburst
    drive = None if bursts is None else (bursts.carrier_hz, bursts.amplitude_vpp)
    time_s = shot.timeline.sensing_s[:MAX_PULSES]
    motion_m = twin.displacement_m(time_s, shot.timeline.burst_onset_s, shot.timeline.burst_length_s, drive)
    step_m = float(np.abs(np.diff(motion_m)).max(initial=0.0))
    # Negated, so that a motion that is not a number is refused.
    if not step_m < quarter_m:
        text = f"the twin moves by up to {step_m * 1e6:.3g} um from a pulse to the next, a quarter wavelength is "
        text += f"{quarter_m * 1e6:.3g} um: the direction of the motion is ambiguous"
        fraction, specimen = 0.9 * quarter_m / step_m, twin.settings.specimen
        less = f"{fraction:.2g} of the motion, by [simulation] or excitation.force_fraction"
        if specimen is not None and specimen.sphere is None:
            less = f"simulation.specimen.force_density_n_per_m3 = {fraction * specimen.force_density_n_per_m3:.2g}"
        remedy = f"{less}, a higher tracking.pulse_rate_hz, or a lower tracking.carrier_hz"
        yield CheckResult("motion between pulses", "refused", text, remedy)


def _level(refused: bool) -> Level:
    return "refused" if refused else "warning"
