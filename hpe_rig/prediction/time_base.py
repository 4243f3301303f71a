"""Phase uncertainty from the clocks, after the fit has narrowed their rate error.

    phase = phi + 2 pi f e t,   I = sum over f of (2 pi f A)² sum (t - mean t)² / (2 s²),   u(e)² = 1 / (1 / a² + I)

e is the rate error of the motion by the clock of the pulses, a the accuracy of the clocks, A the amplitude, s the noise
of a pulse. u(e) changes the phase stated at time t0 by 2 pi f |mean(t) - t0| u(e). The trigger times, which measure
the rate of the pulses, are left out: they reduce a if the digitizer's clock is more accurate than that of the pulses.
Tonebursts at the second input replace u(e) by a far smaller one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.bench import BenchFile, clock_covariance
from hpe_rig.plan import Shot, phase_reference_of, select
from hpe_rig.prediction.conditions import expected_amplitude_m
from hpe_rig.prediction.linear_fit import echo_noise_m, trigger_noise_m
from hpe_rig.processing import predicted_uncertainty, prior_rate_error, spec_of
from hpe_rig.scene import Scene


def time_base_uncertainty(scene: Scene, bench: BenchFile, shot: Shot) -> tuple[float, float, FloatArray]:
    """Return the relative uncertainty of the clocks' rate before and after the fit, and its effect on the phases.

    The effect, rad (frequency,), is the standard uncertainty of each wanted harmonic's phase due to the rate alone. All
    three are 0 if the fit includes a linear drift: a drift absorbs the rate error.
    """
    prior_u = prior_rate_error(scene, clock_covariance(scene, bench), None).uncertainty
    if scene.processing.drift == "linear":
        prior_u = 0.0
    pulses = select(scene, shot)
    time_s, wanted_hz = pulses.time_s[pulses.used], pulses.wanted_hz
    # The rate error is estimated with the coherent displacement, whichever estimator a scene chooses.
    noise_m = math.hypot(echo_noise_m(scene, spec_of("coherent")), trigger_noise_m(scene, bench.simulated))
    posterior_u = prior_u
    if prior_u and noise_m and time_s.size:
        # A rate error e turns the phase of a harmonic by 2 pi f e t: its Fisher information is inverse to the noise.
        amplitude_m = np.array([expected_amplitude_m(scene, float(hz), shot) for hz in wanted_hz])
        slope_m_per_s = 2 * np.pi * wanted_hz * amplitude_m
        information = float(slope_m_per_s @ slope_m_per_s) * time_s.size * float(np.var(time_s)) / (2 * noise_m**2)
        posterior_u = 1 / math.sqrt(1 / prior_u**2 + information)
    if _second_input_is_connected(bench):
        # The second input records the tonebursts themselves, so that their rate is measured without the displacement.
        posterior_u = predicted_uncertainty(shot, posterior_u) or posterior_u
    # A rate error turns the phases about the mean time of the pulses. ``mean_s`` is from the time of the stated phases.
    mean_s = float(time_s.mean()) - phase_reference_of(scene, shot).delay_s if time_s.size else 0.0
    return prior_u, posterior_u, np.asarray(2 * np.pi * wanted_hz * abs(mean_s) * posterior_u)


def time_base_text(scene: Scene, bench: BenchFile, shot: Shot) -> Iterator[str]:
    """Yield the line of the predicted u that the clocks add; nothing for one clock and with a linear drift."""
    prior_u, posterior_u, phase_u_rad = time_base_uncertainty(scene, bench, shot)
    if not prior_u or not phase_u_rad.size:
        return
    wanted_hz, phase_deg = scene.wanted_frequencies_hz, np.degrees(phase_u_rad)
    ends = dict.fromkeys((0, len(wanted_hz) - 1))
    phases = ", ".join(f"{phase_deg[index]:.2g} deg at {wanted_hz[index]:g} Hz" for index in ends)
    yield (
        f"time base: clocks of {prior_u * 1e6:.2g} ppm, {posterior_u * 1e6:.2g} ppm after the fit, add u of the phase "
        f"of {phases}"
    )
    if shot.capture.monitor_range_v is not None and shot.toneburst and not _second_input_is_connected(bench):
        yield (
            "time base: digitizer.monitor_range_v is set, but no cable leads the tonebursts to the second input, which "
            'would measure their rate; add a [[wiring]] with source = "toneburst.output" and target = '
            '"digitizer.channel_b" to the bench file'
        )


def _second_input_is_connected(bench: BenchFile) -> bool:
    return not math.isnan(bench.path_delay_s("toneburst.output", "digitizer.channel_b"))
