from .beam_averaging import (
    BeamWidths as BeamWidths,
    beam_averaging_factor as beam_averaging_factor,
    tracked_motion as tracked_motion,
    tracked_ratio as tracked_ratio,
)
from .ensemble import (
    PRIOR_POWER_MODULUS_HZ as PRIOR_POWER_MODULUS_HZ,
    PRIOR_RANGES as PRIOR_RANGES,
    Ensemble as Ensemble,
    RigidSphere as RigidSphere,
    medium_ensemble as medium_ensemble,
)
from .gate_echoes import TrackingGate as TrackingGate, echo_power as echo_power, scatterer_density as scatterer_density
from .material_laws import (
    HarmonicMedium as HarmonicMedium,
    Law as Law,
    MediumLaw as MediumLaw,
    Parameter as Parameter,
    law_names as law_names,
    law_of as law_of,
)
from .push_force import (
    PushForce as PushForce,
    aperture_force as aperture_force,
    burst_spectrum as burst_spectrum,
    scanned_force as scanned_force,
)
from .shear_field import QUICK_ERROR as QUICK_ERROR, TrackedRegion as TrackedRegion, shear_motion as shear_motion
