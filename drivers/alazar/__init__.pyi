from .api import load_library as load_library
from .ats460 import Ats460 as Ats460
from .limits import mistakes as mistakes
from .models import BoardModel as BoardModel, model_named as model_named
