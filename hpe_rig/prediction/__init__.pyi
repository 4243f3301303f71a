from .beam_averaging import predicted_averaging as predicted_averaging
from .bounds import echo_bound as echo_bound
from .conditions import (
    Conditions as Conditions,
    expected_amplitude_m as expected_amplitude_m,
    expected_snr_db as expected_snr_db,
    relative_drive as relative_drive,
    resting_conditions as resting_conditions,
)
from .detection import FALSE_ALARMS as FALSE_ALARMS, detection_floor as detection_floor
from .error_model import (
    EstimatorErrors as EstimatorErrors,
    estimator_errors as estimator_errors,
    tracked_over_peak as tracked_over_peak,
)
from .forecast import (
    MIN_PULSES_PER_CYCLE as MIN_PULSES_PER_CYCLE,
    conditions_of as conditions_of,
    predict as predict,
    with_beam_averaging as with_beam_averaging,
)
from .linear_fit import fitted_over_true as fitted_over_true, noise_gain as noise_gain
from .output_text import (
    calibration_text as calibration_text,
    extrapolation_text as extrapolation_text,
    focal_distortion as focal_distortion,
)
from .scene_physics import (
    TYPICAL_VOIGT as TYPICAL_VOIGT,
    beam_widths as beam_widths,
    force_spectrum as force_spectrum,
    medium_of as medium_of,
    pulse_length_m as pulse_length_m,
    push_force as push_force,
    tracking_gate as tracking_gate,
)
from .speckle import (
    BOX_HALF_WIDTH_SIGMAS as BOX_HALF_WIDTH_SIGMAS,
    Scattering as Scattering,
    Speckle as Speckle,
    draw_scattering as draw_scattering,
    draw_speckle as draw_speckle,
)
from .speckle_spread import tracked_region_spread as tracked_region_spread
from .text import (
    aliasing_text as aliasing_text,
    averaging_text as averaging_text,
    detection_text as detection_text,
    prediction_text as prediction_text,
)
from .time_base import time_base_text as time_base_text, time_base_uncertainty as time_base_uncertainty
