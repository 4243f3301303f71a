from .comparison import (
    Comparison as Comparison,
    ResultDifference as ResultDifference,
    compare_runs as compare_runs,
    comparison_schema as comparison_schema,
)
from .page import write_report as write_report
from .page_writer import (
    PageSection as PageSection,
    PageTable as PageTable,
    cell_text as cell_text,
    page_table as page_table,
    render_sections as render_sections,
)
from .sweep import Line as Line, fit_line as fit_line
from .views import (
    EchoView as EchoView,
    MotionView as MotionView,
    echo_view as echo_view,
    grey_limit_v as grey_limit_v,
    motion_view as motion_view,
    selected_pulses as selected_pulses,
    tracked_motion as tracked_motion,
)
