"""Forecast of the moduli: how well the places of a scene will tell them, by the Cramer-Rao bound.

The bound of the fit that will be made: the medium's own field at every place, the noise that ``check`` predicts, and
what is not known of widths and places. The medium is the declared one, else the twin's, else a typical muscle.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.medium import shear_motion
from hpe_rig.moduli.inversion import bound
from hpe_rig.moduli.places import depths_of, detected, push_of, strongest, vibration_at, with_shared_noise
from hpe_rig.moduli.vibration_model import Push, Vibration
from hpe_rig.plan import Plan, places_of
from hpe_rig.prediction import TYPICAL, detection_floor, expected_amplitude_m, medium_of, noise_gain
from hpe_rig.scene import Scene, SettingsError


@dataclass(frozen=True, slots=True)
class ModuliForecast:
    """Voigt ``values`` (mu1 Pa, mu2 Pa s) assumed and the uncertainties (2,) to expect from ``places`` places."""

    values: tuple[float, float]
    uncertainty: tuple[float, float]
    places: int
    known: str
    """Whose medium it is."""
    gates: int = 0
    """At all depths of all places."""

    def __str__(self) -> str:
        """Return the line that ``hpe-rig check`` prints."""
        mu1, mu2 = (100 * u / value for u, value in zip(self.uncertainty, self.values, strict=True))
        return (
            f"moduli: mu1 +- {mu1:.2g} %, mu2 +- {mu2:.2g} % from {self.places} place{'s' * (self.places > 1)}"
            f"{f', {self.gates} gates' * (self.gates > self.places)}, for "
            f"{self.known} of {self.values[0] * 1e-3:.4g} kPa and {self.values[1]:.3g} Pa s (Cramer-Rao bound)"
        )


def moduli_forecast(scene: Scene, plan: Plan, simulated: bool = True) -> ModuliForecast:
    """Return how well ``plan`` will tell the moduli of a Voigt medium.

    Raises ``SettingsError`` where the scene does not say how it pushes, and ``ValueError`` where no noise is known, no
    harmonic stands out of it, or those that do are too few.
    """
    push, frequency_hz = push_of([scene]), np.array(scene.wanted_frequencies_hz)
    values, known = _voigt(scene, frequency_hz, simulated)
    if values[1] <= 0:
        raise ValueError("a medium without viscosity has none to tell")
    modulus_pa = values[0] + 2j * np.pi * frequency_hz * values[1]
    places = [(place, part) for place, part in places_of(scene, plan) if part.shots]
    # what noise hangs on is the same at all places, pulses and echoes: as on the axis
    noise_m, shared = _noise_m(_on_axis(places[0][0]), places[0][1], simulated)
    peak_m = expected_amplitude_m(scene, float(frequency_hz[0]), plan.shots[0])
    seen = list[Vibration]()
    for place, part in places:
        here = (_expected(gate, push, modulus_pa, peak_m, noise_m, z) for gate, _, z in depths_of(place, part, []))
        seen += with_shared_noise([one.only(detected(one)) for one in here if detected(one).any()], shared)
    if sum(2 * one.frequency_hz.size for one in seen) <= len(values) + 1:
        raise ValueError("too few harmonics are expected to stand out of the noise")
    sigma = np.sqrt(np.diag(bound(seen, push, "voigt", values)))
    count = len({one.place for one in seen})
    return ModuliForecast(values, (float(sigma[0]), float(sigma[1])), count, known, len(seen))


def moduli_text(scene: Scene, plan: Plan, simulated: bool = True) -> Iterator[str]:
    """Yield the line for a scene that sweeps places; nothing for any other."""
    if len(scene.places) < 2:
        return
    try:
        yield str(moduli_forecast(scene, plan, simulated))
    except SettingsError as error:
        yield f"moduli: left out, {'; '.join(each.what for each in error.mistakes)}"
    except ValueError as error:
        yield f"moduli: left out, {error}"


def _voigt(scene: Scene, frequency_hz: FloatArray, simulated: bool) -> tuple[tuple[float, float], str]:
    """Return the Voigt medium that is as stiff and lossy as what is known, on the mean, and whose it is."""
    found = medium_of(scene, frequency_hz, simulated)
    if found is None:
        return TYPICAL, "a typical medium"
    stiffness, loss = found[0].real.mean(), np.mean(found[0].imag / (2 * np.pi * frequency_hz))
    return (float(stiffness), float(loss)), "the declared medium" if scene.medium is not None else "the twin's medium"


def _on_axis(scene: Scene) -> Scene:
    return scene.model_copy(update={"tracking": scene.tracking.model_copy(update={"lateral_offset_m": 0.0})})


def _noise_m(scene: Scene, plan: Plan, simulated: bool) -> tuple[FloatArray, float]:
    """Return the noise of a quadrature (frequency,) of a place, all its shots that serve together.

    And how far that of two depths correlates: trigger jitter is the same in both.
    """
    shots = [shot for shot in plan.shots if strongest(shot, plan)]
    gain = noise_gain(scene, shots[0])
    floor = detection_floor(scene, simulated, shots[0])
    noise_m = floor.quadrature_m * gain / gain.max() / np.sqrt(len(shots))
    if not noise_m.all():
        raise ValueError("no noise is known: it needs processing.expected_snr_db")
    return np.asarray(noise_m), (floor.trigger_jitter_m / floor.quadrature_m) ** 2


def _expected(
    scene: Scene, push: Push, modulus_pa: ComplexArray, peak_m: float, noise_m: FloatArray, axial_m: float
) -> Vibration:
    """Return the vibration ``axial_m`` off the focus where the focus moves by ``peak_m`` at the first frequency."""
    frequency_hz, covariance = np.array(scene.wanted_frequencies_hz), np.diag(np.repeat(noise_m**2, 2))
    unmoved = np.zeros_like(modulus_pa)
    place = vibration_at(scene, scene.processing.estimator, "", frequency_hz, unmoved, covariance, axial_m)

    def motion(seen_m2: tuple[float, float], lateral_m: float, axial_m: float) -> ComplexArray:
        medium = modulus_pa, frequency_hz, push.density_kg_per_m3, push.force
        field = shear_motion(*medium, *seen_m2, np.array([lateral_m]), axial_m)
        return push.spectrum(frequency_hz) * field.value[:, 0]

    scale = peak_m / abs(motion((0.0, 0.0), 0.0, 0.0)[0])
    phasor_m = scale * motion(place.tracking_m2, place.lateral_m, place.axial_m)
    return replace(place, phasor_m=phasor_m, place=f"{place.lateral_m:g}")
