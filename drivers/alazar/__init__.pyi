from .api import load_library as load_library
from .board import AlazarBoard as AlazarBoard
from .digitizer import AlazarDigitizer as AlazarDigitizer
from .limits import mistakes as mistakes
from .models import BOARD_NAMES as BOARD_NAMES, BoardModel as BoardModel, model_named as model_named
