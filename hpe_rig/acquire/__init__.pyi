from .log import log_path as log_path, logged as logged
from .resumption import prepare_rest as prepare_rest, resume as resume
from .run import (
    Setup as Setup,
    chosen_estimator as chosen_estimator,
    json_schema as json_schema,
    measure as measure,
    planned as planned,
    prepare as prepare,
    prepare_text as prepare_text,
    process as process,
)
from .sequencer import (
    Observer as Observer,
    Progress as Progress,
    ShotBlock as ShotBlock,
    Step as Step,
    acquire as acquire,
    unobserved as unobserved,
)
from .stop_request import (
    StopRequested as StopRequested,
    clear_stop as clear_stop,
    request_stop as request_stop,
    stop_path as stop_path,
    stoppable as stoppable,
)
