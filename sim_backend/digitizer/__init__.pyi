from .board import Board as Board, BoardSettings as BoardSettings, Taken as Taken, latencies_of as latencies_of
from .boards import BOARDS as BOARDS
from .capture_snapshot import (
    FAR_PS as FAR_PS,
    CaptureSnapshot as CaptureSnapshot,
    pulse_of_each_record as pulse_of_each_record,
    same_inputs as same_inputs,
)
from .library import AlazarLibrary as AlazarLibrary
from .recording import Recording as Recording
