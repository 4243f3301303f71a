from .api import load_library as load_library
from .digitizer import AlazarDigitizer as AlazarDigitizer
from .limits import mistakes as mistakes
from .models import BoardModel as BoardModel, model_named as model_named
