"""One board of the vendor's library, opened by its ids; every call is checked."""

from __future__ import annotations

import ctypes
import logging
from collections.abc import Callable
from typing import Any, Final, final

from drivers.alazar import api
from drivers.alazar.api import AlazarLibrary, Capability, Channel, Parameter
from drivers.alazar.models import ATS460_BOARD, MODELS, BoardModel
from drivers.alazar.return_codes import FAILED, SUCCESS, UNSUPPORTED_FUNCTION, check
from drivers.interfaces import InstrumentError

_LOG: Final = logging.getLogger("drivers")


@final
class AlazarBoard:
    """Handle of one board, with its properties.

    ``role`` names the board in messages. Raises ``InstrumentError`` if no board has the ids, or one of another model.
    """

    def __init__(
        self,
        library: AlazarLibrary,
        role: str = "digitizer",
        model: BoardModel = ATS460_BOARD,
        *,
        system_id: int = 1,
        board_id: int = 1,
    ) -> None:
        self.library = library
        self.role = role
        self.model = model
        self.handle = self.invoke(library.AlazarGetBoardBySystemID, system_id, board_id)
        if not self.handle:
            raise InstrumentError(
                role,
                f"no board with system_id {system_id} and board_id {board_id}",
                "the board is not seated, has no driver, or has other ids",
                "look the ids up in the vendor's own program and put them in the bench file",
            )
        self._require_model()
        major = self.sdk_version().partition(".")[0]
        self._sdk_major = int(major) if major.isdecimal() else None

    def call(self, function: Callable[..., int], *arguments: object) -> None:
        """Call a function with the handle as first argument; raise ``InstrumentError`` unless it succeeds."""
        code = int(self.invoke(function, self.handle, *arguments))
        _LOG.debug("%s: %s returns %d", self.role, function.__name__, code)
        self.check(code, function.__name__)

    def invoke(self, function: Callable[..., Any], *arguments: object) -> Any:
        """Return the unchecked result of ``function``; raise ``InstrumentError`` if the library itself fails."""
        try:
            return function(*arguments)
        except OSError as error:
            what, why = f"{function.__name__} broke down: {error}", "the library or its driver is damaged"
            raise InstrumentError(self.role, what, why, "restart the machine, reinstall driver and SDK") from error

    def check(self, code: int, call: str) -> None:
        """Raise ``InstrumentError`` unless ``code`` is success; its name depends on the SDK's version."""
        check(code, call, self.role, self._sdk_major)

    def capability(self, capability: Capability) -> int:
        """Return one fixed property of the board."""
        value = ctypes.c_uint32()
        self.call(self.library.AlazarQueryCapability, int(capability), 0, ctypes.byref(value))
        return int(value.value)

    def parameter(self, parameter: Parameter) -> int | None:
        """Return one state of the board, None if this board or SDK does not report it."""
        value = ctypes.c_long()
        arguments = self.handle, Channel.A, int(parameter), ctypes.byref(value)
        code = self.invoke(self.library.AlazarGetParameter, *arguments)
        if code in (FAILED, UNSUPPORTED_FUNCTION):
            return None
        self.check(code, "AlazarGetParameter")
        return int(value.value)

    def channel_info(self) -> tuple[int, int]:
        """Return the memory in samples per channel, and the bits per sample."""
        samples, bits = ctypes.c_uint32(), ctypes.c_uint8()
        self.call(self.library.AlazarGetChannelInfo, ctypes.byref(samples), ctypes.byref(bits))
        return int(samples.value), int(bits.value)

    def sdk_version(self) -> str:
        """Return the version of the vendor's library."""
        return self._version(self.library.AlazarGetSDKVersion)

    def driver_version(self) -> str:
        """Return the version of the vendor's kernel driver."""
        return self._version(self.library.AlazarGetDriverVersion)

    def has_dual_port_memory(self) -> bool:
        """Return whether the memory can be read during a capture."""
        return self.model.always_dual_port or bool(
            self.capability(Capability.BOARD_OPTIONS_LOW) & api.OPTION_DUAL_PORT_MEMORY
        )

    def max_records(self, record_samples: int) -> int:
        """Return how many records of this length the memory holds, as the board reports it."""
        value = ctypes.c_uint32()
        self.call(self.library.AlazarGetMaxRecordsCapable, record_samples, ctypes.byref(value))
        return int(value.value)

    def samples_per_timestamp(self) -> int:
        """Return the samples a count in the record headers, as reported by the board, else by its model."""
        return self.parameter(Parameter.SAMPLES_PER_TIMESTAMP_CLOCK) or self.model.samples_per_timestamp

    def busy(self) -> bool:
        """Return whether a capture is running."""
        return bool(self.invoke(self.library.AlazarBusy, self.handle))

    def input_clipped(self) -> bool:
        """Return whether the board reports that an input left its range."""
        status = self.invoke(self.library.AlazarGetStatus, self.handle)
        if status == api.STATUS_FAILED:
            what, remedy = f"AlazarGetStatus returned {status:#x}", "restart the machine, check the board's seat"
            raise InstrumentError(self.role, what, "the board does not answer", remedy)
        return bool(status & api.STATUS_CLIPPED)

    def _require_model(self) -> None:
        kind = self.invoke(self.library.AlazarGetBoardKind, self.handle)
        if kind != self.model.kind:
            name = next((model.name for model in MODELS if model.kind == kind), "unknown")
            what = f"the board is of kind {kind} ({name}), expected {self.model.kind} ({self.model.name})"
            remedy = "digitizer.model and the ids of the right board in the bench file"
            raise InstrumentError(self.role, what, "another model sits in this machine", remedy)

    def _version(self, function: Callable[..., int]) -> str:
        numbers = tuple(ctypes.c_uint8() for _ in range(3))
        code = self.invoke(function, *map(ctypes.byref, numbers))
        return ".".join(str(number.value) for number in numbers) if code == SUCCESS else "unknown"
