from .assembly import recover as recover
from .atomic import (
    atomic_file as atomic_file,
    make_folder as make_folder,
    open_ordinary as open_ordinary,
    refuse_unwritable as refuse_unwritable,
    replace_text as replace_text,
    unwritable as unwritable,
    write_file as write_file,
)
from .foreign_hdf5 import (
    InvalidContentError as InvalidContentError,
    bytes_in_memory as bytes_in_memory,
    max_bytes_of as max_bytes_of,
    objects as objects,
    refuse_elsewhere as refuse_elsewhere,
    refuse_expansion as refuse_expansion,
)
from .format import (
    StoreError as StoreError,
    extra as extra,
    free_path as free_path,
    new_run_id as new_run_id,
    reason as reason,
    result_path as result_path,
    versions as versions,
)
from .json_checksum import content_digest as content_digest, read_sealed as read_sealed, sealed_json as sealed_json
from .layout import Predecessor as Predecessor, sha256_of_scan as sha256_of_scan
from .listing import (
    RunEntry as RunEntry,
    list_runs as list_runs,
    listing_schema as listing_schema,
    matching_runs as matching_runs,
    results_of_other_runs as results_of_other_runs,
)
from .lock import acquire as acquire, is_locked as is_locked
from .map_file import write_map as write_map
from .marks import MARKED_BAD as MARKED_BAD, identity_of as identity_of, write_marks as write_marks
from .placement import Placement as Placement, place_records as place_records
from .reader import (
    StoredRun as StoredRun,
    read_run as read_run,
    read_snapshots as read_snapshots,
)
from .records import (
    MISSING as MISSING,
    GatedRecords as GatedRecords,
    ShotRecords as ShotRecords,
    assemble as assemble,
)
from .result_file import read_covariance as read_covariance, write_result as write_result
from .source import open_checked as open_checked
from .stored_records import StoredRecords as StoredRecords
from .verification import (
    Verification as Verification,
    verification_schema as verification_schema,
    verify as verify,
)
from .writer import (
    RunWriter as RunWriter,
    WriteOptions as WriteOptions,
    check_replaceable as check_replaceable,
    refuse_output as refuse_output,
)
