from .axis import Axis as Axis, parse_axes as parse_axes, settings_at_points as settings_at_points
from .description import (
    DescribedKey as DescribedKey,
    DescribedTable as DescribedTable,
    annotated as annotated,
    described as described,
    settings_schema as settings_schema,
)
from .editing import edited_text as edited_text
from .estimator_table import (
    BUILT_IN_ESTIMATORS as BUILT_IN_ESTIMATORS,
    WINDOW_NOISE as WINDOW_NOISE,
    EstimatorProperties as EstimatorProperties,
    Window as Window,
    checked_estimator as checked_estimator,
    estimator_names as estimator_names,
    properties_of as properties_of,
)
from .keys import (
    Key as Key,
    Number as Number,
    forgotten_units as forgotten_units,
    number_keys as number_keys,
    resolve as resolve,
    with_values as with_values,
)
from .notation import engineering as engineering
from .notes import Note as Note
from .points import BENCH as BENCH, IN_TURN as IN_TURN, ScenePoint as ScenePoint
from .quantities import (
    AmplitudeM as AmplitudeM,
    Count as Count,
    DelayS as DelayS,
    DurationS as DurationS,
    FrequencyHz as FrequencyHz,
    IntensityWPerM2 as IntensityWPerM2,
    LatencyS as LatencyS,
    LengthM as LengthM,
    PressurePa as PressurePa,
    Seed as Seed,
    SpeedMPerS as SpeedMPerS,
    VoltageV as VoltageV,
    Widths as Widths,
)
from .scene import (
    DEFAULT_SPECIMEN as DEFAULT_SPECIMEN,
    Estimator as Estimator,
    Excitation as Excitation,
    Medium as Medium,
    Processing as Processing,
    Scene as Scene,
    SceneSource as SceneSource,
    SceneText as SceneText,
    Section as Section,
    Title as Title,
    load_scene as load_scene,
    parse_scene as parse_scene,
    plain_tables as plain_tables,
    scene_text as scene_text,
    shipped_scenes as shipped_scenes,
    with_default_specimen as with_default_specimen,
)
from .validation import (
    MOST_TEXT_BYTES as MOST_TEXT_BYTES,
    KeyPath as KeyPath,
    Mistake as Mistake,
    SettingsError as SettingsError,
    control_character as control_character,
    dotted as dotted,
    length_m as length_m,
    mistakes_of as mistakes_of,
    named_text as named_text,
    parse_toml as parse_toml,
    path_of as path_of,
    printable as printable,
    read_remedy as read_remedy,
    read_settings_text as read_settings_text,
    unreadable as unreadable,
    validated as validated,
)
