from .generators import (
    MasterTrigger33250A as MasterTrigger33250A,
    PulseGenerator33250A as PulseGenerator33250A,
    ToneburstGenerator33250A as ToneburstGenerator33250A,
)
from .limits import (
    pulse_train_mistakes as pulse_train_mistakes,
    toneburst_mistakes as toneburst_mistakes,
    trigger_pulse_mistakes as trigger_pulse_mistakes,
    wiring_mistakes as wiring_mistakes,
)
from .models import GeneratorModel as GeneratorModel, model_named as model_named
