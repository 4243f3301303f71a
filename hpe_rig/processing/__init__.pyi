from .budget import (
    error_sources_of as error_sources_of,
    estimates_of as estimates_of,
    with_second_order_speckle as with_second_order_speckle,
)
from .burst_period import burst_period_motion as burst_period_motion, displacement_residual_m as displacement_residual_m
from .echo.band import Band as Band, band_frequencies_hz as band_frequencies_hz, band_of as band_of
from .echo.conditioning import hann as hann
from .echo.gate import EchoGate as EchoGate, margin_samples as margin_samples
from .estimators import (
    ESTIMATORS as ESTIMATORS,
    EstimatorSpec as EstimatorSpec,
    Options as Options,
    estimate as estimate,
    fit_motion as fit_motion,
    motion_of as motion_of,
    spec_of as spec_of,
)
from .first_pulse import assign_pulses as assign_pulses
from .ground_truth import true_harmonics_m as true_harmonics_m
from .harmonics.drift import drift_of as drift_of, with_drift_uncertainty as with_drift_uncertainty
from .harmonics.fit_checks import residual_line as residual_line
from .harmonics.harmonic_fit import HarmonicFit as HarmonicFit, least_squares as least_squares
from .harmonics.kalman_filter import kalman as kalman
from .harmonics.medium_fit import (
    PRIOR_WIDENING as PRIOR_WIDENING,
    bounded_steepness as bounded_steepness,
    medium_fit as medium_fit,
)
from .harmonics.medium_prior import (
    MediumPrior as MediumPrior,
    harmonic_range_hz as harmonic_range_hz,
    medium_prior as medium_prior,
)
from .harmonics.model import aliased_hz as aliased_hz, harmonic_columns as harmonic_columns
from .harmonics.projected_prior import project_prior as project_prior
from .harmonics.rate_error import (
    RateError as RateError,
    estimate_rate_error as estimate_rate_error,
    with_rate_error as with_rate_error,
)
from .harmonics.velocity_chain import velocity_to_harmonics as velocity_to_harmonics
from .maps.motion_map import MapSettings as MapSettings, map_pixels as map_pixels
from .motion.displacement import (
    Motion as Motion,
    relative_to as relative_to,
    velocity_between_pulses as velocity_between_pulses,
)
from .motion.phase_shift import coherent as coherent
from .motion.spectral_peak import (
    fourier_columns as fourier_columns,
    noisy_peak_steps as noisy_peak_steps,
    orthonormal_rows as orthonormal_rows,
    padded_bins as padded_bins,
)
from .motion_model import fitted_motion as fitted_motion
from .shot_controls import estimate_controls as estimate_controls
from .shot_fitting import (
    options_of as options_of,
    shot_averaging as shot_averaging,
    shot_model as shot_model,
    shot_prior as shot_prior,
)
from .shot_tracking import (
    DAMAGED as DAMAGED,
    NO_RECORDS as NO_RECORDS,
    margin_needed as margin_needed,
    samples_needed as samples_needed,
    shot_echoes as shot_echoes,
    shot_motion as shot_motion,
)
from .shots import Estimates as Estimates, estimate_records as estimate_records, estimate_run as estimate_run
from .stated_motion import (
    estimate_stated_motion as estimate_stated_motion,
    map_stated_motion as map_stated_motion,
)
from .time_base import prior_rate_error as prior_rate_error, shot_fit as shot_fit
from .toneburst_phases import predicted_uncertainty as predicted_uncertainty
