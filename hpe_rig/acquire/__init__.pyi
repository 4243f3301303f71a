from .api import (
    estimate as estimate,
    fit_moduli as fit_moduli,
    measure as measure,
    open_bench as open_bench,
    sweep as sweep,
)
from .checked_scene import CheckedScene as CheckedScene, check as check
from .importing import Imported as Imported, import_recording as import_recording, import_records as import_records
from .log import log_path as log_path, logged as logged
from .mapping import map_motion as map_motion, map_recording as map_recording
from .pause import (
    awaited_place_m as awaited_place_m,
    clear_pause as clear_pause,
    pausable as pausable,
    pause_requested as pause_requested,
    toggle_pause as toggle_pause,
    wait_at_place as wait_at_place,
)
from .places import Mover as Mover
from .provenance import provenance_now as provenance_now
from .queue import (
    QUEUE_FILE as QUEUE_FILE,
    QueueRun as QueueRun,
    Watching as Watching,
    listed as listed,
    new_queue as new_queue,
    read_queue as read_queue,
    run_queue as run_queue,
    time_left_s as time_left_s,
)
from .reprocessing import (
    StoredPoint as StoredPoint,
    estimate_over as estimate_over,
    estimate_points as estimate_points,
    parse_axes as parse_axes,
    points_over as points_over,
)
from .resumption import prepare_rest as prepare_rest, resume as resume
from .run import record_run as record_run
from .run_file import (
    Run as Run,
    chosen_estimator as chosen_estimator,
    open_run as open_run,
    process as process,
)
from .sequencer import (
    Observer as Observer,
    Progress as Progress,
    ShotBlock as ShotBlock,
    Step as Step,
    acquire as acquire,
    programmed as programmed,
    unobserved as unobserved,
)
from .settings_files import (
    full_text as full_text,
    json_schema as json_schema,
    settings_tables as settings_tables,
)
from .setup import (
    Setup as Setup,
    planned as planned,
    prepare as prepare,
    prepare_text as prepare_text,
    source_text as source_text,
)
from .stop_request import (
    StopRequested as StopRequested,
    clear_leftover as clear_leftover,
    clear_stop as clear_stop,
    request_stop as request_stop,
    stop_path as stop_path,
    stop_requested as stop_requested,
    stoppable as stoppable,
    write_stop as write_stop,
)
