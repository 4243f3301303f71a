"""Ideal front end, from the sum over scatterers to volts at the digitizer: gain, noise, toneburst leak.

    gain = echo_rms_v / rms(resting echo of the reference pulse)
    noise rms = echo_rms_v * 10^(-snr_db / 20)                          eq. (16)

The front end has no band limit: the gain is the same at every carrier.
"""

from __future__ import annotations

import math

import numpy as np

from sim_backend.arrays import ComplexArray, FloatArray, Int64Array
from sim_backend.echoes import EchoDelays, echo_pulse, synthesise
from sim_backend.settings import Receiver, SimulationSettings, Specimen
from sim_backend.wiring import PS_PER_S, Bursts

_REFERENCE_CYCLES = 3.0
# For a single echo a fine tolerance costs nothing.
_GAIN_TOLERANCE = 1e-12
_SAMPLES_PER_CYCLE = 16


def reference_gate_s(receiver: Receiver, sound_speed_m_per_s: float) -> FloatArray:
    """Return dense sample times in the reference gate, (sample,), relative to the echo of the focus."""
    length_s = 2 * receiver.reference_gate_m / sound_speed_m_per_s
    count = max(_SAMPLES_PER_CYCLE, math.ceil(length_s * receiver.reference_carrier_hz * _SAMPLES_PER_CYCLE))
    return np.asarray(((np.arange(count) + 0.5) / count - 0.5) * length_s)


def echo_gain_v(
    settings: SimulationSettings, depth_delay_s: FloatArray, weight: FloatArray, response: ComplexArray | None = None
) -> float:
    """Return the volts of a scatterer of weight 1 that give the resting echo an rms of ``echo_rms_v``.

    The rms is that in the reference gate, of the scatterers ``depth_delay_s`` and ``weight`` (scatterer,), with their
    ``response`` (frequency, scatterer), for the reference pulse: 3 cycles, ``reference_pulse_vpp``,
    ``reference_carrier_hz``. Returns 0 without an echo in the gate.
    """
    receiver = settings.receiver
    pulse = echo_pulse(settings, receiver.reference_carrier_hz)
    gate_s = reference_gate_s(receiver, settings.sound_speed_m_per_s)
    at_rest = EchoDelays(depth_delay_s, np.zeros((1, len(weight))), np.zeros((1, 1)), response)
    resting = synthesise(at_rest, weight, pulse, gate_s, _GAIN_TOLERANCE).echo
    rms = float(np.sqrt(np.mean(np.square(resting))))
    return receiver.echo_rms_v / rms if rms > 0 else 0.0


def pulse_strength(pulses: Bursts, receiver: Receiver) -> FloatArray:
    """Return each tracking pulse's strength relative to the reference pulse, (burst,).

    The amplitude of a burst shorter than the transducer's response is proportional to its length.
    """
    return np.asarray(pulses.amplitude_vpp / receiver.reference_pulse_vpp * pulses.cycles / _REFERENCE_CYCLES)


def noise_v(receiver: Receiver, records: int, samples: int, rng: np.random.Generator) -> FloatArray:
    """Return white noise, (record, sample), ``snr_db`` below the resting echo of the reference pulse.

    This is eq. (16) of the paper. A stronger pulse thus has more signal over noise, as on the bench. Zeros without
    ``snr_db``.
    """
    level_v = 0.0 if receiver.snr_db is None else receiver.echo_rms_v * 10 ** (-receiver.snr_db / 20)
    noise = rng.standard_normal((records, samples))
    noise *= level_v
    return noise


def toneburst_echo_strength(tonebursts: Bursts, receiver: Receiver) -> FloatArray:
    """Return each toneburst's echo strength relative to the reference pulse, (burst,), at full amplitude."""
    return np.asarray(receiver.toneburst_echo_gain * tonebursts.amplitude_vpp / receiver.reference_pulse_vpp)


def leak_per_vpp_v(settings: SimulationSettings) -> float:
    """Return the leak of a toneburst into the receiver during transmission, in volts per Vpp at the generator."""
    return settings.receiver.toneburst_leak_v / (settings.specimen or Specimen()).reference_drive_vpp


def leak_v(amplitude_v: float, carrier_hz: float, age_ps: Int64Array) -> FloatArray:
    """Return the leak of one toneburst during transmission, V, at ``age_ps`` (sample,) after its onset."""
    return np.asarray(amplitude_v * np.sin(2 * np.pi * carrier_hz * (age_ps / PS_PER_S)))
