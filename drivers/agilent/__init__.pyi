from .generator import Agilent33250A as Agilent33250A
from .limits import mistakes as mistakes
from .models import MODEL_NAMES as MODEL_NAMES, MODELS as MODELS, model_named as model_named
from .scpi import NoReplyError as NoReplyError
