"""Count outcomes of damage: flipped bits, truncated or lost files, disks that fail or hang.

    python scripts/robustness/integrity.py flips [--cases 1000]         one bit of a run file inverted
    python scripts/robustness/integrity.py truncations [--cases 400]    a run file cut at a random length
    python scripts/robustness/integrity.py faults [--every 1]           the n-th write, sync or truncation fails
    python scripts/robustness/integrity.py hangs [--every 12]           it never returns; Ctrl-C comes a second later
    python scripts/robustness/integrity.py lost                         the file changed, removed or moved during a run

Each is done with plain and with compressed records. A change is SILENT if the result differs from that of the undamaged
file without a message. The exit code is 0 if nothing was silent, crashed or hung. `faults` and `hangs` need Linux and
cc.
"""

from __future__ import annotations

import argparse
import ctypes
import errno
import io
import itertools
import math
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from edited_scenes import prepare_edited, result_table

from hpe_rig.bench import open_bench
from hpe_rig.measurement import Progress, Setup, Step, prepare_resumption, record_run, resume
from hpe_rig.plan import PlanError
from hpe_rig.runs import process
from hpe_rig.scene import SettingsError
from hpe_rig.store import StoreError, WriteOptions, read_run, verify

MESSAGES = (StoreError, SettingsError, PlanError)
EXIT_INTERRUPTED = 130
INTERRUPT_DELAY_S = 1.0
"""Time from a step that does not return to Ctrl-C."""
SAFE_WITHIN_S = 2.0
"""Time within which outputs must be off."""
TIMEOUT_S = 60.0
"""A run normally takes a second; after this time it hangs."""
READABLE, NO_FILE, NO_FAULT = "exit 2, message, file readable", "exit 2, message, no file", "no step failed"
FAILURES = ("SILENT", "AFTER MORE", "HANG")


def two_shots() -> Setup:
    """Prepare a measurement of two shots of 48 records on the simulated bench."""
    acquisition = ("[acquisition]", "[acquisition]\nrepeats = 2\nrecord_samples = 256")
    return prepare_edited("table-1", ("pulse_count = 101", "pulse_count = 48"), acquisition)


# Damage to a stored file.


def flip(data: bytearray, rng: np.random.Generator) -> None:
    """Invert one bit."""
    data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))


def truncate(data: bytearray, rng: np.random.Generator) -> None:
    """Cut the end off."""
    del data[int(rng.integers(len(data))) :]


def damage_copies(compress: bool, cases: int, damage: Callable[[bytearray, np.random.Generator], None]) -> Counter[str]:
    """Return the number of each outcome over ``cases`` damaged copies of one run file."""
    outcomes: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as name:
        path = record_run(two_shots(), Path(name) / "run.h5", options=WriteOptions(compress=compress))
        data, expected, rng = path.read_bytes(), result_table(path), np.random.default_rng(7)
        for _ in range(cases):
            copy = bytearray(data)
            damage(copy, rng)
            path.write_bytes(copy)
            outcome = outcome_of(path, expected)
            outcomes[outcome] += 1
            outcomes["detected by verify"] += is_detected(path)
            if outcome == "SILENT":
                pairs = enumerate(zip(data, copy, strict=False))
                position = next((number for number, (old, new) in pairs if old != new), len(copy))
                print(f"silent: byte {position} of {len(data)}", file=sys.stderr)
    return outcomes


def outcome_of(path: Path, expected: dict[str, Any]) -> str:
    """Process a damaged file and compare its result with that of the undamaged one."""
    try:
        result = result_table(path)
    except MESSAGES:
        return "refused with a message"
    if result == expected:
        return "same result"
    # A result may differ if it names the damage.
    warnings = [*result["warnings"], *(warning for shot in result["shots"] for warning in shot["warnings"])]
    if any("checksum" in text or "cut short" in text or "damaged" in text for text in warnings):
        return "result without the damaged records, with a message"
    return "SILENT"


def is_detected(path: Path) -> bool:
    """Return whether ``verify`` reports damage or refuses the file."""
    try:
        return bool(verify(path).damage)
    except StoreError:
        return True


# Disks that fail or hang, by the preloaded library disk_faults.c.


@dataclass(frozen=True)
class FaultyDisk:
    """A folder with a disk operation that fails or hangs, and the measurement onto it."""

    setup: Setup
    compress: bool
    folder: Path
    library: ctypes.CDLL

    @property
    def disk(self) -> Path:
        return self.folder / "disk"

    @property
    def output(self) -> Path:
        return self.folder / "output"

    def arm(self, number: int, *, permanent: bool = False, code: int = 0, hang: bool = False) -> None:
        """Let operation ``number`` of this process fail with ``code`` (once or permanently) or hang; 0: none."""
        self.library.disk_faults_arm(os.fsencode(self.disk), number, permanent, code, hang)

    def run(self, child: Callable[[], None]) -> tuple[int, str]:
        """Run ``child`` with an empty disk in a copy of this process; return its exit code and output."""
        shutil.rmtree(self.disk, ignore_errors=True)
        self.disk.mkdir()
        return in_child(child, self.output), self.output.read_text()

    def operations(self) -> int:
        """Return the number of disk operations of an undisturbed run."""
        count = self.folder / "count"

        def child() -> None:
            self.arm(0)
            self.measure()
            count.write_text(str(self.library.disk_faults_count()))

        code, output = self.run(child)
        if code:
            raise SystemExit(f"the undisturbed run ended with {code}: {output}")
        return int(count.read_text())

    def measure(self, interrupted_s: list[float] | None = None) -> None:
        """Measure and process with the exit codes of the command line.

        Print the time from the interrupt to the end of the bench, and whether an output is on.
        """
        worlds: list[Any] = []

        @contextmanager
        def watched(*arguments: Any) -> Iterator[Any]:
            try:
                with open_bench(*arguments) as bench:
                    worlds.append(bench.world)
                    yield bench
            finally:
                # The bench verifies on exit that every output is off.
                print(f"safe after {time.monotonic() - (interrupted_s or [math.inf])[0]:.2f} s")

        try:
            with patch.object(sys.modules[record_run.__module__], "open_bench", watched):
                process(record_run(self.setup, self.disk / "run.h5", options=WriteOptions(self.compress)))
        except StoreError as error:
            print(f"hpe-rig: {error}")
            sys.exit(2)
        except KeyboardInterrupt:
            sys.exit(EXIT_INTERRUPTED)
        finally:
            if any(on for world in worlds for on in world.outputs_on().values()):
                print("outputs on")


@contextmanager
def faulty_disk(compress: bool) -> Iterator[FaultyDisk]:
    # Child processes unwind this stack too, so only the parent removes the folder.
    parent, folder = os.getpid(), Path(tempfile.mkdtemp()).resolve()
    try:
        yield FaultyDisk(two_shots(), compress, folder, ctypes.CDLL(None))
    finally:
        if os.getpid() == parent:
            shutil.rmtree(folder)


def faults(compress: bool, stride: int) -> Counter[str]:
    """Return the number of each outcome of runs with one failing disk operation."""
    outcomes: Counter[str] = Counter()
    with faulty_disk(compress) as faulty:
        reference = record_run(faulty.setup, faulty.folder / "reference.h5")
        operations = faulty.operations()
        cases = itertools.product((errno.EIO, errno.ENOSPC), (False, True), range(1, operations + 1, stride))
        for code, permanent, number in cases:
            outcome = one_fault(faulty, reference, partial(faulty.arm, number, permanent=permanent, code=code))
            outcomes[outcome] += 1
            if outcome not in (READABLE, NO_FILE, NO_FAULT):
                case = f"operation {number} of {operations}, {errno.errorcode[code]}, {permanent=}"
                print(f"{compress=}, {case}: {outcome}", file=sys.stderr)
    return outcomes


def one_fault(faulty: FaultyDisk, reference: Path, arm: Callable[[], None]) -> str:
    """Measure with a fault in a child process and classify its end."""

    def child() -> None:
        arm()
        faulty.measure()
        print(NO_FAULT)

    code, output = faulty.run(child)
    # The timeout of ``in_child`` ends a hanging process by SIGKILL.
    if code < 0:
        return "HANG" if code == -signal.SIGKILL else f"CRASH by signal {-code}"
    if code == 0 and output.endswith(f"{NO_FAULT}\n"):
        return NO_FAULT
    if code != 2 or "Try:" not in output or "Traceback" in output or "outputs on" in output:
        return f"exit {code}: {output[-300:]!r}"
    path = faulty.disk / "run.h5"
    if not path.exists():
        return NO_FILE
    try:
        return READABLE if is_intact(path, reference) else "FILE DAMAGED"
    except StoreError as error:
        return f"UNREADABLE: {error}"


def is_intact(path: Path, reference: Path) -> bool:
    """Return whether ``verify`` reports no damage and every record equals that of the undisturbed run."""
    stored, expected = read_run(path), read_run(reference)
    if verify(path).damage or (stored.status == "complete" and not stored.shot_complete.all()):
        return False
    for records, reference_records, complete in zip(
        stored.records, expected.records, stored.shot_complete, strict=True
    ):
        equal = (records.codes[records.valid] == reference_records.codes[records.valid]).all()
        if not equal or (complete and not records.valid.all()):
            return False
    return True


def hangs(compress: bool, stride: int) -> Counter[str]:
    """Return the number of each outcome of runs with a disk operation that never returns, then Ctrl-C."""
    outcomes: Counter[str] = Counter()
    with faulty_disk(compress) as faulty:
        operations = faulty.operations()
        # Omitted: operations that create the log, before the bench is opened. The last two write the result.
        for number in (*range(8, operations - 1, stride), operations - 1, operations):
            code, output = faulty.run(partial(hang, faulty, number))
            safe_after_s = float(output.partition("safe after ")[2].split()[0]) if "safe after" in output else math.inf
            good = code == EXIT_INTERRUPTED and safe_after_s < SAFE_WITHIN_S and "outputs on" not in output
            outcomes["exit 130, outputs off within 2 s" if good else f"HANG, exit {code}: {output[-300:]!r}"] += 1
    return outcomes


def hang(faulty: FaultyDisk, number: int) -> None:
    """Measure; operation ``number`` never returns, and Ctrl-C comes ``INTERRUPT_DELAY_S`` later."""
    hanging_since_s: list[float] = []
    interrupted_s: list[float] = []

    def interrupt(*_: object) -> None:
        # The library counts operations. The time until this one begins depends on the machine's load.
        if faulty.library.disk_faults_count() >= number:
            hanging_since_s.append(time.monotonic())
        if hanging_since_s and not interrupted_s and hanging_since_s[-1] - hanging_since_s[0] >= INTERRUPT_DELAY_S:
            signal.setitimer(signal.ITIMER_REAL, 0)
            interrupted_s.append(hanging_since_s[-1])
            signal.raise_signal(signal.SIGINT)

    faulty.arm(number, hang=True)
    signal.signal(signal.SIGALRM, interrupt)
    signal.setitimer(signal.ITIMER_REAL, 0.1, 0.1)
    faulty.measure(interrupted_s)


def in_child(child: Callable[[], None], output: Path) -> int:
    """Run ``child`` in a copy of this process that exits as any program does; return its exit code."""
    pid = os.fork()
    if pid == 0:
        # File descriptors 1 and 2 also catch what libraries print.
        file = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(file, 1)
        os.dup2(file, 2)
        child()
        sys.exit(0)
    end_s = time.monotonic() + TIMEOUT_S
    while time.monotonic() < end_s:
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.002)
    os.kill(pid, signal.SIGKILL)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def run_with_faulty_disk(arguments: list[str]) -> int:
    """Run this script again with the library that injects the faults, and return its exit code."""
    # The dynamic linker must load the library before the C library, hence a new process.
    source = Path(__file__).with_name("disk_faults.c")
    with tempfile.TemporaryDirectory() as name:
        library = Path(name) / "disk_faults.so"
        subprocess.run(["cc", "-shared", "-fPIC", "-O1", "-o", library, source, "-ldl"], check=True)
        command = [sys.executable, __file__, *arguments]
        return subprocess.run(command, env=os.environ | {"LD_PRELOAD": str(library)}, check=False).returncode


# Changes to the file of a run in progress.


def lost(compress: bool) -> Counter[str]:
    """Return the number of each outcome of runs with a file that is changed within a shot or between two."""
    outcomes: Counter[str] = Counter()
    setup = two_shots()
    for name, change in FILE_CHANGES.items():
        for step in (Step.COLLECT, Step.CONFIGURE):
            with tempfile.TemporaryDirectory() as folder:
                outcomes[f"{name}: {one_loss(setup, Path(folder), compress, change, step)}"] += 1
    return outcomes


def one_loss(setup: Setup, folder: Path, compress: bool, change: Callable[[Path], None], step: Step) -> str:
    """Measure, change the file at ``step`` of the second shot, and classify the end of the run."""
    path, changed_s = folder / "run.h5", list[float]()

    def observe(progress: Progress) -> None:
        if progress.step is step and progress.shot.index == 1 and not changed_s:
            change(path)
            changed_s.append(time.monotonic())

    try:
        record_run(setup, path, observe, options=WriteOptions(compress))
    except StoreError as error:
        if "Try:" not in str(error):
            return "?"
        safe_in_time = time.monotonic() - changed_s[0] < SAFE_WITHIN_S
        return f"noticed, outputs off {'within' if safe_in_time else 'AFTER MORE THAN'} 2 s"
    return "SILENT"


def truncate_in_place(path: Path) -> None:
    os.truncate(path, int(path.stat().st_size * 0.8))


def replace_by_copy(path: Path) -> None:
    """Move a copy of the file over it."""
    Path(shutil.copy(path, path.with_name("copy.h5"))).replace(path)


def append_to(path: Path) -> None:
    with path.open("ab") as file:
        file.write(b"x")


def overwrite_by_run(path: Path) -> None:
    """Try to measure another run into the file; if it is refused, move the file away."""
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()), suppress(StoreError):
        record_run(two_shots(), path, options=WriteOptions(overwrite=True))
        return
    path.rename(path.with_name("refused.h5"))


def resume_from(path: Path) -> None:
    """Try to resume the run in progress; if it is refused, move the file away."""
    with suppress(StoreError):
        resume(prepare_resumption(path), path.with_name("resumed.h5"))
        return
    path.rename(path.with_name("refused.h5"))


FILE_CHANGES: dict[str, Callable[[Path], object]] = {
    "cut": truncate_in_place,
    "removed": Path.unlink,
    "moved": lambda path: path.rename(path.with_name("moved.h5")),
    "replaced": replace_by_copy,
    "appended to": append_to,
    "overwritten by another run: refused, then": overwrite_by_run,
    "resumed meanwhile: refused, then": resume_from,
}


def main() -> int:
    """Run one of the five tests and print the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("test", choices=("flips", "truncations", "faults", "hangs", "lost"))
    parser.add_argument("--cases", type=int, help="damaged copies of each kind of file")
    parser.add_argument("--every", type=int, help="test every n-th disk operation")
    kinds = {"plain": False, "compressed": True}
    parser.add_argument("--kinds", nargs="+", choices=kinds, default=list(kinds), help="kinds of run file")
    options = parser.parse_args()
    if options.test in ("faults", "hangs") and "disk_faults" not in os.environ.get("LD_PRELOAD", ""):
        return run_with_faulty_disk(sys.argv[1:])
    tests: dict[str, Callable[[bool], Counter[str]]] = {
        "flips": lambda compress: damage_copies(compress, options.cases or 1000, flip),
        "truncations": lambda compress: damage_copies(compress, options.cases or 400, truncate),
        "faults": lambda compress: faults(compress, options.every or 1),
        "hangs": lambda compress: hangs(compress, options.every or 12),
        "lost": lost,
    }
    bad = 0
    for kind in options.kinds:
        counts = tests[options.test](kinds[kind])
        cells = "; ".join(f"{count} {outcome}" for outcome, count in counts.most_common())
        print(f"{options.test}, {kind}: {cells}", flush=True)
        for outcome, count in counts.items():
            unexpected = options.test == "faults" and outcome not in (READABLE, NO_FILE, NO_FAULT)
            bad += count * (unexpected or any(word in outcome for word in FAILURES))
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
