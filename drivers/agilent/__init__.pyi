from .generator import Agilent33250A as Agilent33250A
from .limits import mistakes as mistakes
from .models import GeneratorModel as GeneratorModel, model_named as model_named
