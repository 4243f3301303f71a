from .intensity import GaussianSum as GaussianSum, gaussian_sum as gaussian_sum, push_intensity as push_intensity
from .pulse_echo import Mixture as Mixture, PulseEchoBeam as PulseEchoBeam, pulse_echo_beam as pulse_echo_beam
from .radiation import (
    NEPER_PER_DB as NEPER_PER_DB,
    apodisation as apodisation,
    bowl_pressure as bowl_pressure,
    wave_number as wave_number,
)
