from .bench_file import (
    EXCITATION_ROLES as EXCITATION_ROLES,
    GENERATOR_ROLES as GENERATOR_ROLES,
    TRANSPORTS as TRANSPORTS,
    BenchFile as BenchFile,
    BoardName as BoardName,
    Calibration as Calibration,
    Condition as Condition,
    DigitizerBoard as DigitizerBoard,
    DriveCalibration as DriveCalibration,
    OutputLimits as OutputLimits,
)
from .bench_loading import (
    BenchText as BenchText,
    parse_bench as parse_bench,
    read_bench as read_bench,
    with_transducers as with_transducers,
)
from .clocks import clock_covariance as clock_covariance
from .comparison import (
    file_differences as file_differences,
    settings_differences as settings_differences,
)
from .conditions import Reading as Reading, read_conditions as read_conditions
from .emulation import emulate as emulate, is_bench_file as is_bench_file
from .instruments import (
    WITHOUT_OUTPUT as WITHOUT_OUTPUT,
    Bench as Bench,
    UnsafeBenchError as UnsafeBenchError,
)
from .interrupts import (
    DISK_THREAD as DISK_THREAD,
    END_SIGNALS as END_SIGNALS,
    INTERRUPTS as INTERRUPTS,
    Terminated as Terminated,
    interruptible as interruptible,
    uninterrupted as uninterrupted,
)
from .inventory import (
    BenchReport as BenchReport,
    InstrumentReport as InstrumentReport,
    OffState as OffState,
    Settings as Settings,
    displayed_roles as displayed_roles,
    lasting_serial as lasting_serial,
    survey as survey,
    switch_off as switch_off,
    with_serials as with_serials,
)
from .lock import BenchInUseError as BenchInUseError, hold as hold, resources as resources
from .opening import open_bench as open_bench, silent_world as silent_world
from .output_limits import TRANSDUCERS as TRANSDUCERS, Drive as Drive, drive_mistakes as drive_mistakes
from .push_scan import scanned_push as scanned_push
from .twin import (
    TwinDeclaration as TwinDeclaration,
    simulation_schema as simulation_schema,
    twin_of as twin_of,
    twin_settings as twin_settings,
    twin_tables as twin_tables,
)
from .twin_checks import (
    check_declared as check_declared,
    check_simulation as check_simulation,
    contradictions as contradictions,
)
