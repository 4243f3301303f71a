from .budget import (
    Known as Known,
    estimates_of as estimates_of,
    known_of as known_of,
    with_second_order_speckle as with_second_order_speckle,
)
from .burst_period import burst_period_motion as burst_period_motion, residual_m as residual_m
from .echo.band import Band as Band, band_grid as band_grid, band_of as band_of
from .echo.conditioning import codes_to_volts as codes_to_volts, hann as hann, unlike_pulses as unlike_pulses
from .echo.echoes import (
    EchoGate as EchoGate,
    Motion as Motion,
    Velocity as Velocity,
    gate_edge_relative as gate_edge_relative,
    margin_samples as margin_samples,
    relative_to as relative_to,
    velocity_between_pulses as velocity_between_pulses,
)
from .echo.gate_tracking import added as added, follow as follow
from .estimators import (
    ESTIMATORS as ESTIMATORS,
    Estimator as Estimator,
    EstimatorSpec as EstimatorSpec,
    Options as Options,
    Window as Window,
    estimate as estimate,
    fit_motion as fit_motion,
    motion_of as motion_of,
    spec_of as spec_of,
)
from .ground_truth import true_harmonics_m as true_harmonics_m
from .harmonics.aliasing_error import with_unresolved as with_unresolved
from .harmonics.harmonic_fit import (
    HarmonicFit as HarmonicFit,
    Innovations as Innovations,
    MediumPosterior as MediumPosterior,
    least_squares as least_squares,
)
from .harmonics.kalman_filter import kalman as kalman
from .harmonics.medium_prior import (
    WEIGHT as WEIGHT,
    Evidence as Evidence,
    MediumFit as MediumFit,
    MediumPrior as MediumPrior,
    bounded_steepness as bounded_steepness,
    driven_spectrum as driven_spectrum,
    harmonic_range_hz as harmonic_range_hz,
    medium_fit as medium_fit,
    medium_kalman as medium_kalman,
    medium_prior as medium_prior,
    seen_by as seen_by,
)
from .harmonics.model import (
    aliased_hz as aliased_hz,
    harmonic_columns as harmonic_columns,
    linear_model as linear_model,
)
from .harmonics.stationarity import Drift as Drift, drift_between_halves as drift_between_halves
from .harmonics.velocity_chain import Steps as Steps, velocity_to_harmonics as velocity_to_harmonics
from .motion.correlation import cross_correlation as cross_correlation
from .motion.phase_shift import coherent as coherent, coherent_phase as coherent_phase, kasai as kasai, loupas as loupas
from .motion.spectral_peak import (
    cross_spectrum as cross_spectrum,
    fourier_columns as fourier_columns,
    noisy_peak_steps as noisy_peak_steps,
    orthonormal_rows as orthonormal_rows,
    peak_steps as peak_steps,
)
from .motion_map import MapSettings as MapSettings, map_pixels as map_pixels
from .shots import (
    NO_RECORDS as NO_RECORDS,
    Estimates as Estimates,
    FittedMotion as FittedMotion,
    estimate_run as estimate_run,
    fitted_motion as fitted_motion,
    margin_needed as margin_needed,
    options_of as options_of,
    samples_needed as samples_needed,
    shot_echoes as shot_echoes,
    shot_fit as shot_fit,
    shot_media as shot_media,
    shot_model as shot_model,
    shot_motion as shot_motion,
    shot_prior as shot_prior,
)
