"""The vendor's interface as bound: sizes, argument counts, constants, return codes."""

from __future__ import annotations

import ctypes
import inspect
from types import SimpleNamespace

import pytest

from drivers.alazar import api
from drivers.alazar.api import SIGNATURES, Capability, Parameter, bind, load_library
from drivers.alazar.return_codes import MEANINGS, SUCCESS, WAIT_TIMEOUT, check
from drivers.interfaces import InstrumentError
from sim_backend.digitizer import AlazarLibrary

RETURN_CODES = {code: name for code, (name, _) in MEANINGS.items()}


def fake_library() -> SimpleNamespace:
    return SimpleNamespace(**{name: SimpleNamespace() for name in SIGNATURES})


@pytest.mark.parametrize("name", SIGNATURES)
def test_every_signature_has_as_many_arguments_as_the_twins_function(name: str) -> None:
    parameters = inspect.signature(getattr(AlazarLibrary, name)).parameters
    # Behind handle and operation the twin takes two engines of four numbers each.
    engines = 7 if "engines" in parameters else 0
    assert len(SIGNATURES[name][1]) == len(parameters) - 1 + engines


def test_the_vendors_integers_are_32_bit_and_its_long_follows_the_platform() -> None:
    library = bind(fake_library(), "digitizer")
    before = [ctypes.sizeof(kind) for kind in library.AlazarBeforeAsyncRead.argtypes]
    pointer, long = ctypes.sizeof(ctypes.c_void_p), ctypes.sizeof(ctypes.c_long)
    assert before == [pointer, 4, long, 4, 4, 4, 4]
    read = [ctypes.sizeof(kind) for kind in library.AlazarRead.argtypes]
    assert read == [pointer, 4, pointer, 4, long, long, 4]


def test_the_handle_comes_back_in_full_width() -> None:
    """Without a result type ctypes would cut a 64 bit handle to 32 bit."""
    assert bind(fake_library(), "digitizer").AlazarGetBoardBySystemID.restype is ctypes.c_void_p


# How wide the vendor's header declares each out-parameter; a wider one would overwrite its neighbours.
OUT_BITS = {
    "AlazarGetChannelInfo": [32, 8],
    "AlazarGetSDKVersion": [8, 8, 8],
    "AlazarGetDriverVersion": [8, 8, 8],
    "AlazarQueryCapability": [32],
    "AlazarGetParameter": [8 * ctypes.sizeof(ctypes.c_long)],
    "AlazarGetMaxRecordsCapable": [32],
    "AlazarGetTriggerTimestamp": [64],
}


@pytest.mark.parametrize("name", SIGNATURES)
def test_out_parameters_are_as_wide_as_the_vendors_and_refuse_any_other_width(name: str) -> None:
    outs = [kind for kind in SIGNATURES[name][1] if hasattr(kind, "contents")]
    assert [8 * ctypes.sizeof(kind._type_) for kind in outs] == OUT_BITS.get(name, [])
    for kind in outs:
        assert kind.from_param(ctypes.byref(kind._type_())) is not None
        other = ctypes.c_uint16()
        with pytest.raises(TypeError):
            kind.from_param(ctypes.byref(other))


def test_every_missing_function_of_the_library_is_named() -> None:
    library = fake_library()
    del library.AlazarGetTriggerTimestamp, library.AlazarAbortAsyncRead
    with pytest.raises(InstrumentError, match="AlazarGetTriggerTimestamp, AlazarAbortAsyncRead"):
        bind(library, "digitizer")


def test_a_missing_library_says_what_to_install() -> None:
    with pytest.raises(InstrumentError, match="install the AlazarTech driver") as caught:
        load_library(name="no-such-library-anywhere.so")
    assert isinstance(caught.value.__cause__, OSError)


def test_success_passes() -> None:
    check(512, "AlazarStartCapture", "digitizer")


# Picked over the whole table of docs/explanation/instruments.md, 2.8, so that a name too many or too few shifts one.
NAMED = {
    512: "ApiSuccess",
    513: "ApiFailed",
    518: "ApiDmaInProgress",
    531: "ApiNullParam",
    533: "ApiUnsupportedFunction",
    536: "ApiInvalidSize",
    547: "ApiEepromNotPresent",
    556: "ApiNotInitialized",
    561: "ApiNotSupportThisChannel",
    572: "ApiInvalidHandle",
    573: "ApiBufferNotReady",
    579: "ApiWaitTimeout",
    581: "ApiBufferTooSmall",
    582: "ApiBufferOverflow",
    584: "ApiInvalidRecordsPerBuffer",
    589: "ApiTransferComplete",
    591: "ApiNotSupportedInDualChannelMode",
    592: "ApiNotSupportedInQuadChannelMode",
    602: "ApiOCTIgnoreBadClockNotSupported",
    613: "ApiRecordFootersNotSupported",
}


@pytest.mark.parametrize(("code", "name"), NAMED.items())
def test_return_codes_have_the_vendors_names(code: int, name: str) -> None:
    assert RETURN_CODES[code] == name


@pytest.mark.parametrize("code", [code for code in RETURN_CODES if code != SUCCESS])
def test_every_other_code_is_an_error_naming_call_number_name_and_role(code: int) -> None:
    with pytest.raises(InstrumentError) as caught:
        check(code, "AlazarStartCapture", "digitizer")
    text = str(caught.value)
    assert all(part in text for part in ("digitizer", "AlazarStartCapture", str(code), RETURN_CODES[code]))


@pytest.mark.parametrize(
    ("name", "cause"),
    [
        ("ApiFailed", "refused an argument"),
        ("ApiAccessDenied", "another program holds the board"),
        ("ApiUnsupportedFunction", "has no such function"),
        ("ApiInvalidSize", "size is not one the board accepts"),
        ("ApiNoActiveDriver", "kernel driver is not loaded"),
        ("ApiInsufficientResources", "not enough memory"),
        ("ApiInvalidHandle", "not valid any more"),
        ("ApiBufferNotReady", "not posted"),
        ("ApiInvalidDriverVersion", "different versions"),
        ("ApiWaitTimeout", "no trigger arrived"),
        ("ApiBufferTooSmall", "smaller than the records"),
        ("ApiBufferOverflow", "faster than they were read"),
        ("ApiInvalidRecordsPerBuffer", "do not divide the record count"),
        ("ApiLockAndProbePagesFailed", "could not pin the buffers"),
        ("ApiPllNotLocked", "clock is not locked"),
    ],
)
def test_the_likely_cause_matches_the_codes_name(name: str, cause: str) -> None:
    [code] = [code for code, code_name in RETURN_CODES.items() if code_name == name]
    with pytest.raises(InstrumentError, match=f"(?i){cause}"):
        check(code, "AlazarStartCapture", "digitizer")


@pytest.mark.parametrize("code", [603, 604, 607])
def test_codes_that_changed_their_meaning_are_not_given_a_name(code: int) -> None:
    with pytest.raises(InstrumentError, match=f"{code}.*SDK version"):
        check(code, "AlazarStartCapture", "digitizer")


def test_a_refused_record_count_names_the_limit_of_old_fpgas() -> None:
    with pytest.raises(InstrumentError, match=r"604 .*FPGA version 18 and below.*1000"):
        check(604, "AlazarSetRecordCount", "digitizer")


def test_constants_are_those_of_the_reference() -> None:
    assert WAIT_TIMEOUT == 579
    assert api.ADMA_EXTERNAL_STARTCAPTURE | api.ADMA_RECORD_HEADERS == 0x9
    assert int(Capability.BOARD_OPTIONS_LOW) == 0x10000037
    assert int(Parameter.SAMPLES_PER_TIMESTAMP_CLOCK) == 0x10000044
