from .aliasing import fitted_over_true as fitted_over_true, folding_text as folding_text
from .bounds import echo_bound as echo_bound
from .detection import (
    calibration_text as calibration_text,
    detection_floor as detection_floor,
    detection_text as detection_text,
    fit_gain as fit_gain,
)
from .error_model import (
    LATERAL as LATERAL,
    Expected as Expected,
    Scattering as Scattering,
    Setting as Setting,
    Speckle as Speckle,
    draw_scattering as draw_scattering,
    draw_speckle as draw_speckle,
    expected as expected,
)
from .forecast import (
    LEAST_POINTS as LEAST_POINTS,
    averaging_text as averaging_text,
    expected_snr_db as expected_snr_db,
    length_m as length_m,
    predict as predict,
    predicted_averaging as predicted_averaging,
    prediction_text as prediction_text,
    pulse_length_m as pulse_length_m,
    setting_of as setting_of,
)
from .theory import (
    beam_averaging_factor as beam_averaging_factor,
    force_spectrum as force_spectrum,
    scatterer_density as scatterer_density,
)
