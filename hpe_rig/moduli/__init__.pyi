from .forecast import ModuliForecast as ModuliForecast, moduli_forecast as moduli_forecast, moduli_text as moduli_text
from .inversion import Moduli as Moduli, bound as bound, fit_medium as fit_medium
from .outcome import (
    ModuliResult as ModuliResult,
    moduli_of as moduli_of,
    moduli_of_map as moduli_of_map,
    moduli_schema as moduli_schema,
    plane_wave_of as plane_wave_of,
)
from .run_vibrations import Source as Source, vibrations_of as vibrations_of
from .scene_geometry import push_of as push_of, vibration_at as vibration_at
from .vibration_model import Push as Push, Vibration as Vibration
