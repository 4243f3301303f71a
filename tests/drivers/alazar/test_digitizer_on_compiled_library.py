"""The driver on a vendor's library compiled from C: pointers, sizes, posting order and the life of buffers."""

from __future__ import annotations

import ctypes
import dataclasses
import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from drivers.alazar.api import SIGNATURES, load_library
from drivers.alazar.board import AlazarBoard
from drivers.alazar.digitizer import AlazarDigitizer
from drivers.alazar.return_codes import MEANINGS, SUCCESS
from drivers.interfaces import Capture, DeadlineError, InstrumentError

SOURCE = Path(__file__).parent / "compiled" / "ats_fake.c"
RECORDS, SAMPLES = 1000, 512
CAPTURE = Capture(
    sample_rate_hz=100e6,
    record_samples=SAMPLES,
    trigger_delay_samples=9000,
    record_count=RECORDS,
    input_range_v=0.8,
    trigger_level_v=1.5,
)
MODES = ("single_port", "traditional", "npt")

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="the compiled library is built for POSIX systems")


def compiler() -> str:
    configured = (os.environ.get("CC") or sysconfig.get_config_var("CC") or "cc").split()[0]
    path = shutil.which(configured) or shutil.which("cc") or shutil.which("gcc")
    if path is None:
        pytest.fail("no C compiler: these tests build a stand-in for the vendor's library; install gcc, or set CC")
    return path


def build(folder: Path, *flags: str) -> Path:
    library = folder / "libATSApi.so"
    command = [compiler(), "-std=c99", "-Wall", "-Wextra", "-Werror", "-O1", "-g", "-fPIC", "-shared"]
    subprocess.run([*command, *flags, "-o", str(library), str(SOURCE)], check=True)
    return library


@pytest.fixture(scope="session")
def library_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("ats"))


class Ticking:
    """A clock that sleeping moves, and asking too."""

    def __init__(self) -> None:
        self.time_s = 0.0

    def now_s(self) -> float:
        self.time_s += 1e-3
        return self.time_s

    def sleep(self, duration_s: float) -> None:
        self.time_s += duration_s


class Script:
    """The records and time stamps that the compiled library plays, drawn from a seed."""

    def __init__(self, library: Any, records: int = RECORDS, samples: int = SAMPLES) -> None:
        rng = np.random.default_rng(460)
        # Left-justified 14 bit codes without the lowest and highest, which would count as clipped.
        self.words = (rng.integers(1, 2**14 - 1, (records, 2, samples)) << 2).astype(np.uint16)
        # In sample clock periods: a trigger every 10 us at 100 MS/s. As counts of two beyond 32 bits half way through.
        self.stamps = (2**33 - 500 * records + 1000 * np.arange(records)).astype(np.uint64)
        self.library = library
        words = self.words.ctypes.data_as(ctypes.c_void_p)
        library.FakeScript(words, self.stamps.ctypes.data_as(ctypes.c_void_p), records, 2, samples)
        self.options(triggers=records)
        library.FakeFail(b"", SUCCESS)

    def options(self, dual: bool = True, triggers: int = RECORDS, clipped: int = 0, fpga: int = 19) -> None:
        self.library.FakeOptions(int(dual), triggers, clipped, fpga)

    def codes(self, channel: int) -> np.ndarray:
        return (self.words[:, channel] >> 2).astype(np.int16) - 8192


@pytest.fixture
def script(library_path: Path) -> Script:
    return Script(load_library(name=str(library_path)))


def acquire(
    script: Script, mode: str, monitor_range_v: float | None = None, capture: Capture = CAPTURE, **options: Any
) -> SimpleNamespace:
    digitizer = AlazarDigitizer(AlazarBoard(script.library), Ticking(), mode=mode, **options)
    digitizer.configure(dataclasses.replace(capture, monitor_range_v=monitor_range_v))
    digitizer.verify()
    digitizer.arm()
    digitizer.verify()
    blocks = list(digitizer.records(1e9))
    digitizer.make_safe()
    monitors = [block.monitor.codes for block in blocks if block.monitor is not None]
    return SimpleNamespace(
        codes=np.concatenate([block.codes for block in blocks]),
        time_s=np.concatenate([block.trigger_time_s for block in blocks]),
        monitor=np.concatenate(monitors) if monitors else None,
        blocks=blocks,
        digitizer=digitizer,
    )


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("monitor_range_v", [None, 0.4])
def test_a_thousand_records_arrive_byte_for_byte(script: Script, mode: str, monitor_range_v: float | None) -> None:
    got = acquire(script, mode, monitor_range_v)
    assert got.codes.tobytes() == script.codes(0).tobytes()
    if monitor_range_v is not None:
        assert got.monitor.tobytes() == script.codes(1).tobytes()
    if mode == "npt":
        assert np.isnan(got.time_s).all()
    else:
        # On the clock on the wall: triggers every 10 us, whichever way their times come.
        assert np.rint(got.time_s * 100e6).astype(np.uint64).tolist() == script.stamps.tolist()
        np.testing.assert_allclose(np.diff(got.time_s), 10e-6, rtol=0, atol=1e-12)
    assert not got.digitizer.clipped()


@settings(deadline=None, max_examples=60)
@given(
    records=st.integers(1, 60),
    samples=st.integers(4, 16).map(lambda count: 32 * count),
    mode=st.sampled_from(MODES),
    monitor_range_v=st.sampled_from([None, 1.0]),
)
def test_records_of_any_count_and_length_arrive_byte_for_byte(
    library_path: Path, records: int, samples: int, mode: str, monitor_range_v: float | None
) -> None:
    script = Script(load_library(name=str(library_path)), records, samples)
    capture = dataclasses.replace(CAPTURE, record_count=records, record_samples=samples)
    got = acquire(script, mode, monitor_range_v, capture)
    assert got.codes.tobytes() == script.codes(0).tobytes()
    assert monitor_range_v is None or got.monitor.tobytes() == script.codes(1).tobytes()


def test_autodma_runs_through_a_ring_of_four_buffers(script: Script) -> None:
    sizes = []

    def allocate(size: int) -> Any:
        from drivers.alazar.page_buffer import PageBuffer

        sizes.append(size)
        return PageBuffer(size)

    got = acquire(script, "traditional", allocate=allocate)
    assert len(sizes) == 4
    assert len(got.blocks) == 8
    assert script.library.FakePosted() == 0


def test_the_handle_is_a_pointer_of_full_width(script: Script) -> None:
    handle = script.library.AlazarGetBoardBySystemID(1, 1)
    assert handle > 2**32
    assert script.library.AlazarGetBoardKind(handle) == 7
    assert script.library.AlazarBusy(handle & 0xFFFF_FFFF) == 0


def test_the_library_exports_every_function_of_the_interface(library_path: Path) -> None:
    assert all(hasattr(ctypes.CDLL(str(library_path)), name) for name in SIGNATURES)


@pytest.mark.parametrize("mode", MODES)
def test_records_before_missing_triggers_are_delivered_and_counted(script: Script, mode: str) -> None:
    script.options(triggers=700)
    digitizer = AlazarDigitizer(AlazarBoard(script.library), Ticking(), mode=mode)
    digitizer.configure(CAPTURE)
    digitizer.arm()
    blocks = []
    with pytest.raises(DeadlineError, match="700 of 1000 records"):
        blocks.extend(digitizer.records(5.0))
    codes = np.concatenate([block.codes for block in blocks])
    assert codes.tobytes() == script.codes(0)[:700].tobytes()
    assert script.library.FakePosted() == 0


@pytest.mark.parametrize("bits", [2, 4])
def test_the_boards_clipped_flags_are_reported(script: Script, bits: int) -> None:
    script.options(clipped=bits)
    assert acquire(script, "traditional").digitizer.clipped()


def test_an_old_fpga_takes_a_thousand_single_port_records_at_most(script: Script) -> None:
    script.options(fpga=18)
    assert len(acquire(script, "single_port").codes) == 1000
    digitizer = AlazarDigitizer(AlazarBoard(script.library), Ticking(), mode="single_port")
    with pytest.raises(InstrumentError, match=r"1001.*FPGA version 18.*1000"):
        digitizer.configure(Capture(100e6, SAMPLES, 9000, 1001, 0.8, 1.5))


CODES = [code for code in (*MEANINGS, 603, 604, 607) if code not in (SUCCESS, 579)]


@pytest.mark.parametrize(
    "code", [pytest.param(code, marks=() if code % 10 < 2 or code == 603 else pytest.mark.slow) for code in CODES]
)
def test_every_return_code_becomes_an_error_with_call_number_and_meaning(script: Script, code: int) -> None:
    calls = ("AlazarSetCaptureClock", "AlazarStartCapture", "AlazarWaitAsyncBufferComplete")
    call = calls[code % 3]
    script.library.FakeFail(call.encode(), code)
    with pytest.raises(InstrumentError) as caught:
        acquire(script, "traditional")
    text = str(caught.value)
    assert f"{call} returned {code} (" in text
    name, _ = MEANINGS.get(code, ("SDK" if code == 603 else "Api", ""))
    assert name in text
    assert len(text) > 80
    assert script.library.FakePosted() == 0


@pytest.mark.parametrize("call", [name for name, (kind, _) in SIGNATURES.items() if kind is ctypes.c_int])
@pytest.mark.parametrize(
    "mode", ["npt", *(pytest.param(mode, marks=pytest.mark.slow) for mode in MODES if mode != "npt")]
)
def test_a_refusal_of_any_call_leaves_no_buffer_with_the_board(script: Script, call: str, mode: str) -> None:
    script.library.FakeFail(call.encode(), 513)
    refused = ""
    try:
        acquire(script, mode)
    except InstrumentError as error:
        refused = str(error)
    assert call in refused or not refused
    assert script.library.FakePosted() == 0


SANITIZED = """
import ctypes, sys
sys.path[:0] = {path!r}
import test_digitizer_on_compiled_library as tests
from drivers.alazar.api import load_library

libc = ctypes.CDLL(None)
libc.memalign.restype, libc.memalign.argtypes = ctypes.c_void_p, [ctypes.c_size_t, ctypes.c_size_t]
libc.free.argtypes = [ctypes.c_void_p]

class Exact:
    # Memory of exactly the size asked for, from an allocator that the sanitizer watches.
    def __init__(self, size_bytes):
        self.size_bytes = size_bytes
        self.address = libc.memalign(64, size_bytes)
        self.freed = False
    def copy(self, dtype, count):
        import numpy as np
        return np.frombuffer(ctypes.string_at(self.address, dtype.itemsize * count), dtype).copy()
    def free(self):
        if not self.freed:
            libc.free(self.address)
        self.freed = True

script = tests.Script(load_library(name={library!r}))
if {defect!r} == "freed too soon":
    from drivers.alazar.captures import DualPortCapture
    abort = DualPortCapture.abort
    def freed_first(capture):
        for buffer in capture._buffers:
            buffer.free()
        abort(capture)
    DualPortCapture.abort = freed_first
if {defect!r} == "too small":
    from drivers.alazar import captures
    captures.READ_MARGIN_SAMPLES = 0
for mode in tests.MODES:
    for monitor_range_v in (None, 0.4):
        script.options()
        got = tests.acquire(script, mode, monitor_range_v, allocate=Exact)
        assert got.codes.tobytes() == script.codes(0).tobytes()
    script.options(triggers=700)
    try:
        digitizer = tests.AlazarDigitizer(
            tests.AlazarBoard(script.library), tests.Ticking(), mode=mode, allocate=Exact
        )
        digitizer.configure(tests.CAPTURE)
        digitizer.arm()
        list(digitizer.records(5.0))
    except tests.DeadlineError:
        pass
print("all modes done")
"""


@pytest.mark.slow
@pytest.mark.parametrize("defect", ["none", "freed too soon", "too small"])
def test_the_address_sanitizer_finds_no_write_outside_a_posted_buffer(tmp_path: Path, defect: str) -> None:
    """The planted defects show that the sanitizer watches."""
    gcc = compiler()
    runtime = subprocess.run([gcc, "-print-file-name=libasan.so"], capture_output=True, text=True, check=True)
    if not Path(runtime.stdout.strip()).is_absolute():
        pytest.skip("this compiler has no address sanitizer")
    library = build(tmp_path, "-fsanitize=address")
    path = [str(Path(__file__).parent), str(Path(__file__).parents[3])]
    program = SANITIZED.format(path=path, library=str(library), defect=defect)
    settings = {"LD_PRELOAD": runtime.stdout.strip(), "ASAN_OPTIONS": "detect_leaks=0", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, env=os.environ | settings, check=False
    )
    if defect == "none":
        assert done.returncode == 0, done.stderr[-3000:]
        assert "all modes done" in done.stdout
    else:
        kind = "heap-use-after-free" if defect == "freed too soon" else "heap-buffer-overflow"
        assert done.returncode != 0
        assert kind in done.stderr
