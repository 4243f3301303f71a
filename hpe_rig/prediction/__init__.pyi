from .aliasing import fitted_over_true as fitted_over_true
from .amplitude import (
    expected_amplitude_m as expected_amplitude_m,
    expected_snr_db as expected_snr_db,
    relative_drive as relative_drive,
)
from .beam_averaging import (
    TYPICAL as TYPICAL,
    beam_widths as beam_widths,
    depth_in_gate as depth_in_gate,
    force_of as force_of,
    medium_motion as medium_motion,
    medium_of as medium_of,
    predicted_averaging as predicted_averaging,
    pulse_length_m as pulse_length_m,
    resting_conditions as resting_conditions,
    tracked_spread as tracked_spread,
)
from .bounds import echo_bound as echo_bound
from .detection import FALSE_ALARMS as FALSE_ALARMS, detection_floor as detection_floor
from .error_model import (
    LATERAL as LATERAL,
    Conditions as Conditions,
    Expected as Expected,
    Scattering as Scattering,
    Speckle as Speckle,
    draw_scattering as draw_scattering,
    draw_speckle as draw_speckle,
    expected as expected,
    tracked_over_peak as tracked_over_peak,
)
from .forecast import (
    LEAST_POINTS as LEAST_POINTS,
    as_averaged as as_averaged,
    conditions_of as conditions_of,
    forecast_of as forecast_of,
    predict as predict,
)
from .linear_fit import noise_gain as noise_gain
from .text import (
    aliasing_text as aliasing_text,
    averaging_text as averaging_text,
    calibration_text as calibration_text,
    detection_text as detection_text,
    extrapolation_text as extrapolation_text,
    prediction_text as prediction_text,
)
from .theory import (
    beam_averaging_factor as beam_averaging_factor,
    echo_power as echo_power,
    focal_distortion as focal_distortion,
    force_spectrum as force_spectrum,
    scatterer_density as scatterer_density,
)
