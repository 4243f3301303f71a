from .axis import Axis as Axis, parse_axes as parse_axes
from .description import (
    DescribedTable as DescribedTable,
    annotated as annotated,
    described as described,
)
from .editing import edited_text as edited_text
from .estimator_table import (
    BUILT_IN_ESTIMATORS as BUILT_IN_ESTIMATORS,
    EstimatorProperties as EstimatorProperties,
    checked_estimator as checked_estimator,
    estimator_names as estimator_names,
    properties_of as properties_of,
)
from .keys import (
    Key as Key,
    Number as Number,
    plain_tables as plain_tables,
    resolve as resolve,
    with_values as with_values,
)
from .loading import (
    SceneSource as SceneSource,
    SceneText as SceneText,
    load_scene as load_scene,
    number_keys as number_keys,
    parse_scene as parse_scene,
    scene_text as scene_text,
    with_default_specimen as with_default_specimen,
)
from .mistakes import (
    KeyPath as KeyPath,
    Mistake as Mistake,
    SettingsError as SettingsError,
    control_character as control_character,
    dotted as dotted,
    path_of as path_of,
    printable as printable,
)
from .quantities import (
    AmplitudeM as AmplitudeM,
    Count as Count,
    DelayS as DelayS,
    DurationS as DurationS,
    Estimator as Estimator,
    FrequencyHz as FrequencyHz,
    IntensityWPerM2 as IntensityWPerM2,
    LatencyS as LatencyS,
    LengthM as LengthM,
    PressurePa as PressurePa,
    SampleRateHz as SampleRateHz,
    SampleTimeS as SampleTimeS,
    Seed as Seed,
    SpeedMPerS as SpeedMPerS,
    Title as Title,
    VoltageV as VoltageV,
    Widths as Widths,
)
from .removed_keys import current_simulation as current_simulation, omitted_keys as omitted_keys
from .scene import Scene as Scene, ScenePoint as ScenePoint, scene_mistakes as scene_mistakes
from .sections import (
    SWEPT_LISTS as SWEPT_LISTS,
    UNSTATED_FREQUENCY_ACCURACY as UNSTATED_FREQUENCY_ACCURACY,
    Acquisition as Acquisition,
    Excitation as Excitation,
    Processing as Processing,
    Tracking as Tracking,
)
from .settings_file import (
    MAX_TEXT_BYTES as MAX_TEXT_BYTES,
    named_text as named_text,
    parse_settings as parse_settings,
    parse_toml as parse_toml,
    read_settings_text as read_settings_text,
    unreadable as unreadable,
)
from .units import (
    MIN_LENGTH_M as MIN_LENGTH_M,
    engineering as engineering,
    length_m as length_m,
    plural as plural,
)
from .usual_values import forgotten_units as forgotten_units, shipped_scenes as shipped_scenes
from .validation import (
    Section as Section,
    mistakes_of as mistakes_of,
    validated as validated,
)
