from .accuracy.motion import (
    PARAMETERS as PARAMETERS,
    MotionCase as MotionCase,
    MotionRow as MotionRow,
    case_rows as case_rows,
    gate as gate,
    twin_echoes as twin_echoes,
)
from .accuracy.own_scene import write_own_scene as write_own_scene
from .accuracy.report import (
    FULL as FULL,
    Effort as Effort,
    write_accuracy as write_accuracy,
    write_accuracy_report as write_accuracy_report,
)
from .paper.experiments import write_page as write_page
from .paper.force_lines import figure_15 as figure_15
from .paper.muscle import (
    figure_16 as figure_16,
    figure_17 as figure_17,
    figure_18 as figure_18,
    figure_19 as figure_19,
    table_2 as table_2,
)
from .paper.reproduction import reproduction_part as reproduction_part
from .paper.sphere import fit_sphere as fit_sphere, steel_sphere as steel_sphere
from .paper.twin import dose as dose, figure_1 as figure_1, figure_14 as figure_14, interference as interference
