from .command_tree import tree_of as tree_of
from .emission import TRIGGER_INPUT_OHM as TRIGGER_INPUT_OHM, TRIGGER_LEVEL_V as TRIGGER_LEVEL_V
from .instrument import Generator33250A as Generator33250A
from .models import MODELS as MODELS, with_serial as with_serial
from .scpi_text import ScpiError as ScpiError
