from .inversion import (
    Moduli as Moduli,
    Push as Push,
    Vibration as Vibration,
    bound as bound,
    compare_media as compare_media,
    fit_medium as fit_medium,
)
from .media import LAWS as LAWS, MediumLaw as MediumLaw
from .shear_speed import fit_voigt as fit_voigt, speed_of_runs as speed_of_runs
