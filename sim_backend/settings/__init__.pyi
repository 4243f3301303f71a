from .chain import BandFilter as BandFilter, LogAmplifier as LogAmplifier, ReceiveChain as ReceiveChain
from .simulation import (
    Beams as Beams,
    Instruments as Instruments,
    MotionComponent as MotionComponent,
    Receiver as Receiver,
    Reflector as Reflector,
    Scatterers as Scatterers,
    SimulationSettings as SimulationSettings,
    Specimen as Specimen,
    Transmitter as Transmitter,
)
