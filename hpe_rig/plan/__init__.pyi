from .checks.acoustic_output import (
    calibration_expiry as calibration_expiry,
    drive_output as drive_output,
    highest_output as highest_output,
)
from .checks.check_result import (
    CheckResult as CheckResult,
    PlanError as PlanError,
    refuse_conflicts as refuse_conflicts,
)
from .checks.checklist import check_plan as check_plan, likely_causes as likely_causes
from .checks.depth_gates import gates_over_depth as gates_over_depth
from .gate_profile import (
    DepthGate as DepthGate,
    depth_gates as depth_gates,
    shots_with_gate as shots_with_gate,
    with_gate as with_gate,
    without_shared_echoes as without_shared_echoes,
)
from .interference import (
    CLEAN as CLEAN,
    INSIDE as INSIDE,
    NEAR as NEAR,
    disturbed_pulses as disturbed_pulses,
    follow_tonebursts as follow_tonebursts,
    precede_tonebursts as precede_tonebursts,
    pulse_kinds as pulse_kinds,
)
from .omitted import omissions as omissions
from .phase_reference import (
    SAME_TIME_ZERO as SAME_TIME_ZERO,
    PhaseReference as PhaseReference,
    phase_definition as phase_definition,
    phase_reference_of as phase_reference_of,
    time_zero_event as time_zero_event,
)
from .selection import (
    MAX_CONDITION as MAX_CONDITION,
    Selection as Selection,
    driven_frequencies_hz as driven_frequencies_hz,
    select as select,
    window_pulse_count as window_pulse_count,
)
from .shots import (
    SAFETY_MARGIN_S as SAFETY_MARGIN_S,
    Plan as Plan,
    Shot as Shot,
    Timeline as Timeline,
    control_shots as control_shots,
    make_plan as make_plan,
    off_axis_offsets_m as off_axis_offsets_m,
    plans_at_offsets as plans_at_offsets,
    reference_gate as reference_gate,
    scene_of_shot as scene_of_shot,
)
from .timeline import plan_text as plan_text
from .timing_figure import timing_pictures as timing_pictures
