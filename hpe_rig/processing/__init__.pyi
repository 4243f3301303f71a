from .conditioning import codes_to_volts as codes_to_volts, hann as hann
from .correlation import cross_correlation as cross_correlation
from .echoes import (
    EchoGate as EchoGate,
    Motion as Motion,
    Velocity as Velocity,
    band_grid as band_grid,
    velocity_between_pulses as velocity_between_pulses,
)
from .estimators import (
    ESTIMATORS as ESTIMATORS,
    Estimator as Estimator,
    Options as Options,
    estimate as estimate,
    fit_motion as fit_motion,
    motion_of as motion_of,
)
from .flags import unlike_pulses as unlike_pulses
from .gate_tracking import added as added, follow as follow
from .ground_truth import true_harmonics_m as true_harmonics_m
from .harmonic import HarmonicFit as HarmonicFit, Innovations as Innovations, least_squares as least_squares
from .kalman_filter import kalman as kalman
from .maximum_likelihood import joint as joint
from .model import design as design, harmonic_columns as harmonic_columns
from .motion import (
    coherent as coherent,
    coherent_phase as coherent_phase,
    cross_spectrum as cross_spectrum,
    kasai as kasai,
    loupas as loupas,
    peak_phase as peak_phase,
)
from .reference import relative_to as relative_to
from .shots import (
    design_of as design_of,
    driven_frequencies_hz as driven_frequencies_hz,
    estimate_run as estimate_run,
    options_of as options_of,
    shot_echoes as shot_echoes,
    skipped_pulses as skipped_pulses,
)
from .stationarity import Drift as Drift, drift_between_halves as drift_between_halves
from .velocity_chain import Steps as Steps, velocity_to_harmonics as velocity_to_harmonics
