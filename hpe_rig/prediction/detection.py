"""What a scene can detect, beside what the limits of acoustic output let the medium move."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from hpe_rig.bench import BenchFile, twin_dose
from hpe_rig.plan import Shot, drive_output
from hpe_rig.prediction.forecast import expected_snr_db, used_pulses
from hpe_rig.processing import design_of
from hpe_rig.scene import Scene

MISSED = 20
"""A floor is what noise alone exceeds in one of so many measurements."""
HANN_NOISE = 1.5
"""N sum w^2 / (sum w)^2 of a Hann window: what it adds to a variance, in the gate and again in slow time."""
LISTED = 4
AGREEING = 2.0
"""Intensities further apart than this factor are not of one transducer: attenuation over the way is known no better."""


@dataclass(frozen=True, slots=True)
class Floor:
    """Noise of a displacement amplitude; standard deviations of one quadrature, m."""

    noise_m: float
    jitter_m: float

    @property
    def quadrature_m(self) -> float:
        """Noise and jitter together."""
        return math.hypot(self.noise_m, self.jitter_m)

    @property
    def detected_m(self) -> float:
        """The amplitude that noise alone exceeds in one of ``MISSED`` measurements: a quantile of Rayleigh's law."""
        return self.quadrature_m * math.sqrt(2 * math.log(MISSED))


def detection_floor(scene: Scene, simulated: bool = True, shot: Shot | None = None) -> Floor:
    """Return the floor of an amplitude: echo noise, and the jitter between pulse and sampling clock.

    ``shot`` tells which pulses the estimate skips, and so what it costs to fit the other driven harmonics along.

    A pulse's phase in white noise has the variance 1 / (samples in the gate x SNR), its time of flight that of the
    trigger jitter (twin alone; a real bench's is not known); over N pulses a quadrature has 2/N of either. Theory
    notes, section 2 and 3; model notes, section 5.
    """
    acquisition, snr_db = scene.acquisition, expected_snr_db(scene)
    samples = 2 * acquisition.gate_length_m / acquisition.sound_speed_m_per_s * acquisition.sample_rate_hz
    metres_per_radian = acquisition.sound_speed_m_per_s / (4 * math.pi * scene.tracking.carrier_hz)
    windowed = HANN_NOISE if scene.processing.estimator == "cross_spectrum" else 1.0
    over_pulses = math.sqrt(2 * windowed / used_pulses(scene))
    if shot is not None and scene.processing.estimator != "cross_spectrum":
        # A plan with conflicts may have no fit at all.
        with suppress(ValueError):
            over_pulses = _quadrature_gain(scene, shot)
    noise_m = 0.0
    if snr_db is not None:
        noise_m = metres_per_radian * math.sqrt(windowed / (samples * 10 ** (snr_db / 10)))
    jitter_s = (scene.simulation or {}).get("instruments", {}).get("trigger_jitter_s", 0.0) if simulated else 0.0
    return Floor(noise_m * over_pulses, jitter_s * acquisition.sound_speed_m_per_s / 2 * over_pulses)


def fit_gain(scene: Scene, shot: Shot) -> float:
    """Return the noise of the worst wanted quadrature over that of a sinusoid fitted alone to all pulses; else 1.

    Above 1 where pulses are skipped and the other driven harmonics, fitted along, are hardly told from the wanted ones.
    """
    with suppress(ValueError):
        return _quadrature_gain(scene, shot) / math.sqrt(2 / used_pulses(scene))
    return 1.0


def _quadrature_gain(scene: Scene, shot: Shot) -> float:
    """Return the noise of the worst wanted quadrature over that of a pulse, by the least squares that are fitted."""
    _, model = design_of(scene, shot)
    return float(np.linalg.norm(model.root[: 2 * len(scene.wanted_frequencies_hz)], axis=1).max())


def detection_text(scene: Scene, simulated: bool = True, shot: Shot | None = None) -> Iterator[str]:
    """Yield the detection floor and, where the medium is known, what moves at the FDA's track-3 limit.

    One line a burst length; for ``hpe-rig check`` and the report.
    """
    floor = detection_floor(scene, simulated, shot)
    if floor.quadrature_m == 0:
        yield "detection floor: none, neither noise nor trigger jitter is known"
    else:
        yield (
            f"detection floor: {floor.detected_m * 1e9:.3g} nm, exceeded by noise ({floor.noise_m * 1e9:.3g} nm in "
            f"each quadrature) and trigger jitter ({floor.jitter_m * 1e9:.3g} nm) in one of {MISSED} measurements"
        )
    if scene.excitation is None:
        return
    frequency_hz = np.array(scene.wanted_frequencies_hz[:LISTED])
    for length_s in scene.excitation.burst_length_s:
        found = twin_dose(scene, length_s, frequency_hz) if simulated else None
        if found is None:
            continue
        moved = zip(frequency_hz.tolist(), found.displacement_limit_m.tolist(), strict=True)
        yield (
            f"dose: at the limit of FDA track 3 ({found.limit_w_per_m2 * 1e-4:.4g} W/cm2 while a toneburst of "
            f"{length_s * 1e6:g} us is on, {found.force_limit_n_per_m3 * 1e-3:.3g} kN/m3) the focus moves "
            + ", ".join(f"{limit_m * 1e9:.3g} nm at {hz:g} Hz" for hz, limit_m in moved)
            + f"; the twin's force at {found.reference_drive_vpp:g} Vpp is "
            f"{found.intensity_w_per_m2 / found.limit_w_per_m2:.3g} times that"
        )


def calibration_text(scene: Scene, bench: BenchFile) -> Iterator[str]:
    """Yield how the bench file's calibration contradicts the twin's force, where their intensities are far apart.

    Body force 2 a I / c, as in the twin; the calibration derated as for the limits.
    """
    drive = None if bench.calibration is None else bench.calibration.toneburst
    if not bench.simulated or bench.calibration is None or drive is None or scene.excitation is None:
        return
    found = twin_dose(scene, scene.excitation.burst_length_s[0], np.zeros(1))
    if found is None:
        return
    depth_m, drive_vpp = bench.calibration.focus_depth_m, found.reference_drive_vpp
    stated_w_per_m2 = drive_output(drive, depth_m, drive_vpp, 1.0).sppa_w_per_m2
    ratio = found.intensity_w_per_m2 / stated_w_per_m2
    if not 1 / AGREEING < ratio < AGREEING:
        yield (
            f"calibration: [calibration] of the bench file states {stated_w_per_m2 * 1e-4:.3g} W/cm2 at {drive_vpp:g} "
            f"Vpp, the twin's force stands for {found.intensity_w_per_m2 * 1e-4:.3g} W/cm2, {ratio:.3g} times that: "
            "the acoustic output by this calibration is not the output that moves the twin"
        )
