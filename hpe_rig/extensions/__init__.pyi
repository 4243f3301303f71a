from .entry_points import (
    CONDITIONS as CONDITIONS,
    ESTIMATORS as ESTIMATORS,
    IMPORTERS as IMPORTERS,
    MEDIA as MEDIA,
    ExtensionError as ExtensionError,
    installed as installed,
    load as load,
    named as named,
    origin as origin,
)
