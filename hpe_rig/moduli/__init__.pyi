from .shear_speed import fit_voigt as fit_voigt, speed_of_runs as speed_of_runs
