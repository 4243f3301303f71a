from .between_shots import Mover as Mover
from .commissioning import (
    CableResult as CableResult,
    Operator as Operator,
    Tap as Tap,
    commission as commission,
    record_commissioning as record_commissioning,
    taps as taps,
    twin_operator as twin_operator,
)
from .log import run_log as run_log
from .provenance import provenance_now as provenance_now
from .queue import (
    QueueHooks as QueueHooks,
    QueueList as QueueList,
    QueueRun as QueueRun,
    new_queue as new_queue,
    queue_entries as queue_entries,
    read_queue as read_queue,
    run_queue as run_queue,
    stop_queue as stop_queue,
    time_left_s as time_left_s,
)
from .requests import (
    StopRequested as StopRequested,
    awaited_offset_m as awaited_offset_m,
    clear_stale_stop as clear_stale_stop,
    clearing_requests as clearing_requests,
    pause_requested as pause_requested,
    request_stop as request_stop,
    stop_path as stop_path,
    stop_requested as stop_requested,
    toggle_pause as toggle_pause,
    wait_for_move as wait_for_move,
    with_requests as with_requests,
)
from .resumption import prepare_resumption as prepare_resumption, resume as resume
from .run import record_run as record_run
from .sequencer import (
    Observer as Observer,
    Progress as Progress,
    ShotBlock as ShotBlock,
    Step as Step,
    acquire as acquire,
    program_shot as program_shot,
)
from .setup import (
    BenchSource as BenchSource,
    Setup as Setup,
    plan_and_check as plan_and_check,
    prepare as prepare,
    prepare_text as prepare_text,
    setup_of_run as setup_of_run,
    source_text as source_text,
)
