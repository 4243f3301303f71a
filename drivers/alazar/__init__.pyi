from .api import load_library as load_library
from .ats460 import Ats460 as Ats460
from .limits import capture_mistakes as capture_mistakes
