from .accuracy.motion import MotionCase as MotionCase
from .accuracy.own_scene import write_own_scene as write_own_scene
from .accuracy.report import (
    FULL as FULL,
    Effort as Effort,
    write_accuracy as write_accuracy,
    write_accuracy_report as write_accuracy_report,
)
from .paper.judgement import sidak_quantile as sidak_quantile
from .paper.reproduction import reproduction_part as reproduction_part
