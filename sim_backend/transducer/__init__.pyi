from .burgers import Layer as Layer, advance as advance
from .hydrophone import Scan as Scan, read_scan as read_scan, round_field as round_field
from .intensity import GaussianSum as GaussianSum, push_intensity as push_intensity
from .nonlinear import (
    Accuracy as Accuracy,
    Beam as Beam,
    nonlinear_beam as nonlinear_beam,
)
from .pulse_echo import Mixture as Mixture, pulse_echo_beam as pulse_echo_beam
from .push import (
    Push as Push,
    WaterOutput as WaterOutput,
    equivalent_force as equivalent_force,
    path as path,
    push_of as push_of,
    water_output as water_output,
)
from .radiation import (
    apodisation as apodisation,
    bowl_pressure as bowl_pressure,
    wave_number as wave_number,
)
