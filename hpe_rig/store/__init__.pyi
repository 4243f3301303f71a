from .atomic import (
    atomic_file as atomic_file,
    refuse_unwritable as refuse_unwritable,
    unwritable as unwritable,
)
from .format import (
    StoreError as StoreError,
    extra as extra,
    free_path as free_path,
    reason as reason,
    result_path as result_path,
    versions as versions,
)
from .layout import Predecessor as Predecessor
from .reader import (
    StoredGroundTruth as StoredGroundTruth,
    StoredRecords as StoredRecords,
    StoredRun as StoredRun,
    read_run as read_run,
    read_snapshots as read_snapshots,
)
from .records import GatedRecords as GatedRecords, ShotRecords as ShotRecords, assemble as assemble
from .result_file import write_result as write_result
from .validation import UntrustedError as UntrustedError, trusted as trusted
from .writer import RunWriter as RunWriter, WriteOptions as WriteOptions
