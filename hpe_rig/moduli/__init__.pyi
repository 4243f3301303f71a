from .dispersion import (
    DispersionResult as DispersionResult,
    dispersion_of as dispersion_of,
    dispersion_of_vibrations as dispersion_of_vibrations,
    dispersion_schema as dispersion_schema,
)
from .forecast import ModuliForecast as ModuliForecast, moduli_forecast as moduli_forecast, moduli_text as moduli_text
from .inversion import Moduli as Moduli, bound as bound, fit_medium as fit_medium
from .outcome import (
    ModuliResult as ModuliResult,
    moduli_of as moduli_of,
    moduli_of_map as moduli_of_map,
    moduli_schema as moduli_schema,
)
from .run_vibrations import Source as Source, vibrations_of as vibrations_of
from .scene_geometry import push_of as push_of, vibration_at as vibration_at
from .vibration_model import Push as Push, Vibration as Vibration
from .wave_methods import phase_velocity_map as phase_velocity_map
from .wavenumber_fit import DispersionCurve as DispersionCurve, fit_wavenumbers as fit_wavenumbers
