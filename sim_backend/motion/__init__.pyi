from .acoustic_dose import Dose as Dose, dose as dose
from .field import (
    MediumMotion as MediumMotion,
    field_transfer as field_transfer,
    focus_response as focus_response,
    focus_transfer as focus_transfer,
    force_shape as force_shape,
    medium_motion as medium_motion,
)
from .force import (
    ForcePulses as ForcePulses,
    force_scale as force_scale,
    radiation_force as radiation_force,
)
from .inverse_laplace import AXIS_CONTOUR as AXIS_CONTOUR, Contour as Contour, Panels as Panels, panels_of as panels_of
from .prescribed import background_at as background_at, motion_at as motion_at
from .specimen import (
    StepResponse as StepResponse,
    frequency_response as frequency_response,
    settling_time_s as settling_time_s,
    shear_modulus as shear_modulus,
    transfer as transfer,
    transient_displacement as transient_displacement,
)
from .sphere import sphere_response as sphere_response
