from .installed_media import BUILT_IN_MEDIA as BUILT_IN_MEDIA, creeps as creeps, modulus_of as modulus_of
from .instruments import Instruments as Instruments, TriggerFaults as TriggerFaults
from .receiver import (
    BandFilter as BandFilter,
    LogAmplifier as LogAmplifier,
    ReceiveChain as ReceiveChain,
    Receiver as Receiver,
)
from .simulation import (
    BackgroundMotion as BackgroundMotion,
    Beams as Beams,
    MotionComponent as MotionComponent,
    Propagation as Propagation,
    Reflector as Reflector,
    Scatterers as Scatterers,
    SimulationSettings as SimulationSettings,
    Specimen as Specimen,
    Sphere as Sphere,
    Transducer as Transducer,
    Transmitter as Transmitter,
    scatterer_count as scatterer_count,
)
