from .editing import edited_text as edited_text
from .keys import (
    Key as Key,
    Number as Number,
    container_at as container_at,
    number_keys as number_keys,
    path_of as path_of,
    resolve as resolve,
    with_values as with_values,
)
from .scene import (
    Count as Count,
    Estimator as Estimator,
    NonNegative as NonNegative,
    Positive as Positive,
    Processing as Processing,
    Scene as Scene,
    SceneText as SceneText,
    Section as Section,
    Title as Title,
    parse_scene as parse_scene,
    scene_text as scene_text,
    shipped_scenes as shipped_scenes,
)
from .validation import (
    KeyPath as KeyPath,
    Mistake as Mistake,
    SettingsError as SettingsError,
    mistakes_of as mistakes_of,
    parse_toml as parse_toml,
)
