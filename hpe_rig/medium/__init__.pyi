from .ensemble import (
    BRANCH_OVER_MODULUS as BRANCH_OVER_MODULUS,
    LOW_VISCOSITY_PA_S as LOW_VISCOSITY_PA_S,
    MAXWELL_VISCOSITY_PA_S as MAXWELL_VISCOSITY_PA_S,
    MEMBERS as MEMBERS,
    MODULUS_PA as MODULUS_PA,
    POWER as POWER,
    POWER_REFERENCE_HZ as POWER_REFERENCE_HZ,
    VISCOSITY_PA_S as VISCOSITY_PA_S,
    BeamWidths as BeamWidths,
    Ensemble as Ensemble,
    KnownMedium as KnownMedium,
    RigidSphere as RigidSphere,
    displacement_and_slope as displacement_and_slope,
    medium_ensemble as medium_ensemble,
    seen_beside as seen_beside,
)
from .material_laws import (
    LAWS as LAWS,
    Law as Law,
    MediumLaw as MediumLaw,
    Parameter as Parameter,
    law_names as law_names,
    law_of as law_of,
)
from .push_force import PushForce as PushForce, aperture_force as aperture_force, scanned_force as scanned_force
from .shear_field import (
    QUICK_ERROR as QUICK_ERROR,
    ShearMotion as ShearMotion,
    focal_motion as focal_motion,
    shear_motion as shear_motion,
)
