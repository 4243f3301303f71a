from .burgers import Layer as Layer, advance as advance
from .nonlinear import Accuracy as Accuracy, Beam as Beam, nonlinear_beam as nonlinear_beam
from .push import Push as Push, equivalent_force as equivalent_force, path as path, push_of as push_of
from .radiation import (
    NEPER_PER_DB as NEPER_PER_DB,
    apodisation as apodisation,
    bowl_pressure as bowl_pressure,
    wave_number as wave_number,
)
