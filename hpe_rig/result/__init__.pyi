from .conditions import ConditionSummary as ConditionSummary, condition_summary as condition_summary
from .covariance import PARTS as PARTS, Covariance as Covariance, covariance_grid as covariance_grid
from .figure import setting_pictures as setting_pictures
from .figure_kind import FigureKind as FigureKind
from .grid import MOTION_UNITS as MOTION_UNITS, UNITS as UNITS, result_grid as result_grid
from .influence import MAX_INFLUENCE_BYTES as MAX_INFLUENCE_BYTES, Influence as Influence, Scope as Scope
from .json_schema import (
    dataclass_schema as dataclass_schema,
    object_schema as object_schema,
    result_schema as result_schema,
    titled as titled,
)
from .motion import MOST_PULSES as MOST_PULSES, ShotMotion as ShotMotion
from .motion_map import BadPixel as BadPixel, MotionMap as MotionMap
from .panels import figure_panels as figure_panels
from .phase import (
    DETECTED as DETECTED,
    PHASE_VARIANCE_LIMIT as PHASE_VARIANCE_LIMIT,
    PRIOR_ODDS as PRIOR_ODDS,
    RAYLEIGH_SQUARE as RAYLEIGH_SQUARE,
    phase_variance_at_rad2 as phase_variance_at_rad2,
    phase_variance_rad2 as phase_variance_rad2,
    rectified_variance_m2 as rectified_variance_m2,
)
from .print_symbols import symbols as symbols
from .provenance import Provenance as Provenance, Stages as Stages
from .repeats import (
    INDEPENDENT_SOURCES as INDEPENDENT_SOURCES,
    REPEAT_SETTINGS as REPEAT_SETTINGS,
    RepeatMean as RepeatMean,
    repeat_means as repeat_means,
    setting_of as setting_of,
)
from .result import Result as Result
from .result_data import json_text as json_text, json_values as json_values, shot_warnings as shot_warnings
from .rows import result_csv as result_csv
from .sentence import (
    amplitude_text as amplitude_text,
    estimate_at as estimate_at,
    frequency_error_text as frequency_error_text,
    headline_sentence as headline_sentence,
    lead_frequency_hz as lead_frequency_hz,
    phase_text as phase_text,
    probability_text as probability_text,
    scale_of as scale_of,
    with_u as with_u,
)
from .setting_text import (
    common_settings as common_settings,
    control_text as control_text,
    setting_table as setting_table,
    setting_texts as setting_texts,
    varied_settings as varied_settings,
)
from .spectra import main_shot as main_shot, means_of as means_of, spectrum_pictures as spectrum_pictures
from .svg import (
    MARKS as MARKS,
    PALETTE as PALETTE,
    STYLE as STYLE,
    Colour as Colour,
    Picture as Picture,
    figure_bytes as figure_bytes,
    image as image,
    inline as inline,
    label_decades as label_decades,
    legend as legend,
    mark as mark,
    page_style as page_style,
    panel as panel,
    picture as picture,
    thin as thin,
)
from .tables import csv_text as csv_text, mappings as mappings, rich_table as rich_table, text_table as text_table
from .values import (
    RECTIFIED as RECTIFIED,
    Averaging as Averaging,
    AveragingRule as AveragingRule,
    Component as Component,
    Estimate as Estimate,
    GateResult as GateResult,
    ShotResult as ShotResult,
)
