from .installed_media import OWN_MEDIA as OWN_MEDIA, creeps as creeps, modulus_of as modulus_of
from .simulation import (
    BackgroundMotion as BackgroundMotion,
    BandFilter as BandFilter,
    Beams as Beams,
    Instruments as Instruments,
    LogAmplifier as LogAmplifier,
    MotionComponent as MotionComponent,
    ReceiveChain as ReceiveChain,
    Receiver as Receiver,
    Reflector as Reflector,
    Scatterers as Scatterers,
    SimulationSettings as SimulationSettings,
    Specimen as Specimen,
    Transducer as Transducer,
    Transmitter as Transmitter,
    resolution_cell_m3 as resolution_cell_m3,
    scatterer_count as scatterer_count,
)
