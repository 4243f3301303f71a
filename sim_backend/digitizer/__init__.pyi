from .board import (
    AcceptedTriggers as AcceptedTriggers,
    Board as Board,
    BoardSettings as BoardSettings,
    Latencies as Latencies,
)
from .boards import BOARDS as BOARDS
from .capture_snapshot import FAR_PS as FAR_PS, CaptureSnapshot as CaptureSnapshot, pulse_onsets_ps as pulse_onsets_ps
from .direct_input import INPUTS as INPUTS, direct_volts as direct_volts
from .library import AlazarLibrary as AlazarLibrary
from .recording import Recording as Recording
