from .installed_media import BUILT_IN_MEDIA as BUILT_IN_MEDIA, creeps as creeps, modulus_of as modulus_of
from .instruments import ClockErrors as ClockErrors, Instruments as Instruments, TriggerFaults as TriggerFaults
from .receiver import (
    BandFilter as BandFilter,
    LogAmplifier as LogAmplifier,
    ReceiveChain as ReceiveChain,
    Receiver as Receiver,
)
from .simulation import (
    Beams as Beams,
    Reflector as Reflector,
    Scatterers as Scatterers,
    SimulationSettings as SimulationSettings,
    Transducer as Transducer,
    scatterer_count as scatterer_count,
)
from .specimen import (
    BackgroundMotion as BackgroundMotion,
    MotionComponent as MotionComponent,
    Propagation as Propagation,
    Specimen as Specimen,
    Sphere as Sphere,
)
