from .entry_points import (
    CONDITIONS as CONDITIONS,
    ESTIMATORS as ESTIMATORS,
    IMPORTERS as IMPORTERS,
    MEDIA as MEDIA,
    TIMEOUT_S as TIMEOUT_S,
    VALUES_PER_S as VALUES_PER_S,
    ExtensionError as ExtensionError,
    call as call,
    installed as installed,
    load as load,
    named as named,
    origin as origin,
)
