from .contents import Contents as Contents, Importer as Importer
from .export_files import (
    Echoes as Echoes,
    ExportFormat as ExportFormat,
    Label as Label,
    export_image as export_image,
)
from .importers import foreign_importer as foreign_importer
from .recording import (
    Recording as Recording,
    Source as Source,
    as_source as as_source,
    read_recording as read_recording,
)
from .scanners import differing_setting as differing_setting
from .settings import (
    RecordingSettings as RecordingSettings,
    read_settings as read_settings,
)
