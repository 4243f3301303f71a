from .checks.acoustic_output import (
    AcousticOutput as AcousticOutput,
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
    apart as apart,
    depth_gates as depth_gates,
    shots_with_gate as shots_with_gate,
    with_gate as with_gate,
)
from .interference import disturbed_pulses as disturbed_pulses
from .omitted import omissions as omissions
from .selection import (
    LARGEST_CONDITION as LARGEST_CONDITION,
    Selection as Selection,
    driven_frequencies_hz as driven_frequencies_hz,
    select as select,
    window_pulse_count as window_pulse_count,
)
from .shots import (
    SAFETY_MARGIN_S as SAFETY_MARGIN_S,
    Plan as Plan,
    Shot as Shot,
    make_plan as make_plan,
    offsets_beside_m as offsets_beside_m,
    places_of as places_of,
    reference_gate as reference_gate,
    scene_of as scene_of,
)
from .timeline import plan_text as plan_text
from .timing_figure import timing as timing
