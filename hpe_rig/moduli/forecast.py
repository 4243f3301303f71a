"""Forecast of the moduli: their expected uncertainties from a scene, by the Cramer-Rao bound.

The bound is that of the later fit: the shear field at every lateral offset, the noise that ``check`` predicts, and the
uncertainties of widths and positions. The medium is the declared one, else the twin's, else a typical muscle.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.medium import HarmonicMedium, TrackedRegion, shear_motion
from hpe_rig.moduli.inversion import bound
from hpe_rig.moduli.scene_geometry import (
    GateAtDepth,
    detected_part,
    gates_at_depths,
    has_strongest_push,
    push_of,
    vibration_at,
    with_shared_noise,
)
from hpe_rig.moduli.vibration_model import Push, Vibration
from hpe_rig.plan import Plan, plans_at_offsets
from hpe_rig.prediction import TYPICAL_VOIGT, detection_floor, expected_amplitude_m, medium_of, noise_gain
from hpe_rig.scene import Scene, SettingsError


@dataclass(frozen=True, slots=True)
class ModuliForecast:
    """Assumed Voigt ``values`` (mu1 Pa, mu2 Pa s) and expected ``uncertainty`` (2,).

    From ``lateral_offsets`` offsets with ``gates`` in total; ``medium_source`` names the source of the medium.
    """

    values: tuple[float, float]
    uncertainty: tuple[float, float]
    lateral_offsets: int
    medium_source: str
    gates: int = 0

    def __str__(self) -> str:
        """Return the line that ``hpe-rig check`` prints: expected uncertainties of mu1 and mu2, assumed medium."""
        mu1, mu2 = (100 * u / value for u, value in zip(self.uncertainty, self.values, strict=True))
        gates = f", {self.gates} gates" if self.gates > self.lateral_offsets else ""
        return (
            f"moduli: mu1 +- {mu1:.2g} %, mu2 +- {mu2:.2g} % from {self.lateral_offsets} lateral offset"
            f"{'s' * (self.lateral_offsets > 1)}{gates}, in {self.medium_source} of "
            f"{self.values[0] * 1e-3:.4g} kPa and {self.values[1]:.3g} Pa s (Cramer-Rao bound)"
        )


def moduli_forecast(scene: Scene, plan: Plan, simulated: bool = True) -> ModuliForecast:
    """Return the expected uncertainties of the moduli of a Voigt medium from the shots of ``plan``: a Cramer-Rao bound.

    Raises ``SettingsError`` if the scene states no push, and ``ValueError`` if no noise is known or too few harmonics
    exceed it.
    """
    push, frequency_hz = push_of([scene]), np.array(scene.wanted_frequencies_hz)
    values, medium_source = _voigt_medium(scene, frequency_hz, simulated)
    if values[1] <= 0:
        raise ValueError("a medium without viscosity has no viscosity to fit")
    medium = replace(HarmonicMedium.voigt(*values, frequency_hz), density_kg_per_m3=push.density_kg_per_m3)
    offsets = [
        (at_offset, offset_plan) for at_offset, offset_plan in plans_at_offsets(scene, plan) if offset_plan.shots
    ]
    # Pulses and echoes, hence the noise, are the same at all offsets: computed on the axis.
    first_scene, first_plan = offsets[0]
    on_axis = first_scene.tracking.model_copy(update={"lateral_offset_m": 0.0})
    noise_m, correlation = _noise_m(first_scene.model_copy(update={"tracking": on_axis}), first_plan, simulated)
    peak_m = expected_amplitude_m(scene, float(frequency_hz[0]), plan.shots[0])
    vibrations = list[Vibration]()
    for at_offset, offset_plan in offsets:
        gates = gates_at_depths(at_offset, offset_plan, [])
        expected = (_expected_vibration(gate, push, medium, peak_m, noise_m) for gate in gates)
        detected = [part for vibration in expected for part in detected_part(vibration, [])]
        vibrations += with_shared_noise(detected, correlation)
    # Two numbers for each harmonic, against the parameters and the common amplitude.
    if sum(2 * vibration.frequency_hz.size for vibration in vibrations) <= len(values) + 1:
        raise ValueError("too few harmonics are expected to exceed the noise")
    u1, u2 = np.sqrt(np.diag(bound(vibrations, push, "voigt", values))).tolist()
    return ModuliForecast(
        values=values,
        uncertainty=(u1, u2),
        lateral_offsets=len({vibration.position for vibration in vibrations}),
        medium_source=medium_source,
        gates=len(vibrations),
    )


def moduli_text(scene: Scene, plan: Plan, simulated: bool = True) -> Iterator[str]:
    """Yield the line of ``hpe-rig check`` with the expected uncertainties of the moduli, or why there is none.

    Yields nothing for a scene that does not sweep lateral offsets.
    """
    if len(scene.places) < 2:
        return
    try:
        yield str(moduli_forecast(scene, plan, simulated))
    except SettingsError as error:
        yield f"moduli: no forecast, {'; '.join(mistake.what for mistake in error.mistakes)}"
    except ValueError as error:
        yield f"moduli: no forecast, {error}"


def _voigt_medium(scene: Scene, frequency_hz: FloatArray, simulated: bool) -> tuple[tuple[float, float], str]:
    """Return the Voigt medium that a forecast assumes (modulus in Pa, viscosity in Pa s), and its source in words.

    It has the mean stiffness and loss, over ``frequency_hz``, of the declared or simulated medium, else typical ones.
    """
    medium = medium_of(scene, frequency_hz, simulated)
    if medium is None:
        return TYPICAL_VOIGT, "a typical medium"
    stiffness_pa = medium.modulus_pa.real.mean()
    viscosity_pa_s = np.mean(medium.modulus_pa.imag / (2 * np.pi * frequency_hz))
    source = "the declared medium" if scene.medium is not None else "the twin's medium"
    return (float(stiffness_pa), float(viscosity_pa_s)), source


def _noise_m(scene: Scene, plan: Plan, simulated: bool) -> tuple[FloatArray, float]:
    """Return the noise of a quadrature (frequency,), m, and the correlation of that noise between two depths.

    The noise is that of all usable shots at one lateral offset. Trigger jitter is common to all depths.
    """
    shots = [shot for shot in plan.shots if has_strongest_push(shot, plan)]
    # The detection floor states the noise at the worst frequency; at others it is less, in proportion to the gain.
    gain = noise_gain(scene, shots[0])
    floor = detection_floor(scene, simulated, shots[0])
    noise_m = floor.quadrature_m * gain / gain.max() / np.sqrt(len(shots))
    if not noise_m.all():
        raise ValueError("no noise is known. Try: processing.expected_snr_db")
    return np.asarray(noise_m), (floor.trigger_jitter_m / floor.quadrature_m) ** 2


def _expected_vibration(
    gate: GateAtDepth, push: Push, medium: HarmonicMedium, peak_m: float, noise_m: FloatArray
) -> Vibration:
    """Return the vibration of ``medium`` expected in ``gate``, if the focus moves by ``peak_m`` at the first frequency.

    ``noise_m`` (frequency,): standard deviation of a quadrature.
    """
    scene, estimator = gate.scene, gate.scene.processing.estimator
    covariance_m2 = np.diag(np.repeat(noise_m**2, 2))
    unmoved = medium.frequency_hz, np.zeros_like(medium.modulus_pa), covariance_m2
    vibration = vibration_at(scene, estimator, "", unmoved, gate.axial_m)

    def motion(region: TrackedRegion) -> ComplexArray:
        """Return the phasors (frequency,) of the displacement tracked in ``region``, per unit of force."""
        return np.asarray(push.spectrum(medium.frequency_hz) * shear_motion(medium, push.force, region).value[:, 0])

    # The field is per unit force: scale it to the expected amplitude at the focus.
    scale = peak_m / abs(motion(TrackedRegion(np.zeros(1)))[0])
    tracked = TrackedRegion(np.array([vibration.lateral_m]), vibration.axial_m, *vibration.tracking_m2)
    return replace(vibration, phasor_m=scale * motion(tracked), position=f"{vibration.lateral_m:g}")
