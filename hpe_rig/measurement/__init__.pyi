from .log import log_path as log_path, logged as logged
from .mover import Mover as Mover
from .pause import (
    awaited_place_m as awaited_place_m,
    clear_pause as clear_pause,
    pausable as pausable,
    pause_requested as pause_requested,
    toggle_pause as toggle_pause,
    wait_at_place as wait_at_place,
)
from .provenance import provenance_now as provenance_now
from .queue import (
    QUEUE_FILE as QUEUE_FILE,
    QueueList as QueueList,
    QueueRun as QueueRun,
    Watching as Watching,
    listed as listed,
    new_queue as new_queue,
    read_queue as read_queue,
    run_queue as run_queue,
    time_left_s as time_left_s,
)
from .resumption import prepare_rest as prepare_rest, resume as resume
from .run import record_run as record_run
from .sequencer import (
    Observer as Observer,
    Progress as Progress,
    ShotBlock as ShotBlock,
    Step as Step,
    acquire as acquire,
    programmed as programmed,
    unobserved as unobserved,
)
from .setup import (
    BenchSource as BenchSource,
    Setup as Setup,
    as_path as as_path,
    bench_path as bench_path,
    planned as planned,
    prepare as prepare,
    prepare_text as prepare_text,
    source_text as source_text,
    with_scan_beside as with_scan_beside,
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
