from .simulation import (
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
    Transmitter as Transmitter,
)
