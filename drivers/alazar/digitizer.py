"""AlazarTech board as the bench's digitizer: external trigger, AUX trigger output, echoes at channel A."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict
from typing import Final, Self, final

import numpy as np
from numpy.typing import NDArray

from drivers.alazar import api, samples
from drivers.alazar.api import AlazarLibrary, Capability, Channel, Parameter
from drivers.alazar.board import AlazarBoard
from drivers.alazar.captures import DualPortCapture, SinglePortCapture
from drivers.alazar.limits import Mode, level_code, mistakes
from drivers.alazar.models import ATS460_BOARD, BoardModel
from drivers.alazar.page_buffer import PageBuffer
from drivers.alazar.samples import RawRecords
from drivers.interfaces import Capture, Clock, Identity, InstrumentError, MonitorRecords, RecordBlock, Setting

UNSIGNED_FORMAT: Final = 0
ZERO_LEVEL_CODE: Final = 128


@final
class AlazarDigitizer:
    """One board of ``model``; which of its ways to capture is taken follows from its memory, unless ``mode`` says.

    ``allocate`` makes the page-aligned memory that the board writes into. At the end of a ``with`` statement the
    capture is aborted, verified, and its memory freed.
    """

    def __init__(
        self,
        library: AlazarLibrary,
        clock: Clock,
        role: str = "digitizer",
        system_id: int = 1,
        board_id: int = 1,
        allocate: Callable[[int], PageBuffer] = PageBuffer,
        mode: Mode | None = None,
        model: BoardModel = ATS460_BOARD,
    ) -> None:
        self._board = AlazarBoard(library, role, system_id, board_id, model)
        self._model = model
        self._clock = clock
        self._allocate = allocate
        self._wanted_mode = mode
        self._capture: Capture | None = None
        self._mode: SinglePortCapture | DualPortCapture | None = None
        self._clipped = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.make_safe()

    @property
    def role(self) -> str:
        """The part this instrument plays on the bench."""
        return self._board.role

    def identify(self) -> Identity:
        """Return the board's serial number and the versions of FPGA, driver and SDK."""
        board = self._board
        fpga = board.capability(Capability.FPGA_VERSION)
        firmware = f"FPGA {fpga}, driver {board.driver_version()}, SDK {board.sdk_version()}"
        return Identity("AlazarTech", self._model.name, str(board.capability(Capability.SERIAL_NUMBER)), firmware)

    def configure(self, capture: Capture) -> None:
        """Program the board; raise ``InstrumentError`` for what it cannot do, all of it at once."""
        chosen = self._chosen_mode()
        fpga = self._board.capability(Capability.FPGA_VERSION)
        found = "; ".join(refusal.text for refusal in mistakes(capture, self._model, chosen, fpga))
        if found:
            why = f"the {self._model.name} cannot do this, and nothing was sent to it"
            raise InstrumentError(self.role, found, why, "change the value in the scene or bench file")
        self._disarm()
        self._capture = self._mode = None
        self._program(capture)
        mode = self._made_mode(chosen, capture)
        mode.prepare()
        self._capture, self._mode = capture, mode

    def verify(self) -> Mapping[str, Setting]:
        """Return the ``snapshot``; raise ``InstrumentError`` where what the board reports contradicts the programmed.

        The vendor's interface reads most settings back nowhere; what it can report is compared.
        """
        _, mode = self._configured("verify")
        parameter = self._board.parameter
        expected = {
            "bits per sample": (self._model.code_bits, self._board.channel_info()[1]),
            "data format": (UNSIGNED_FORMAT, parameter(Parameter.DATA_FORMAT)),
            "capture running": (mode.armed, self._board.busy()),
            "buffers pending": (mode.buffers_posted(), parameter(Parameter.ASYNC_BUFFERS_PENDING)),
        }
        wrong = [
            f"{name} expected {want:d}, the board reports {read:d}"
            for name, (want, read) in expected.items()
            if read is not None and read != want
        ]
        if wrong:
            why = "another program changed the board, or a capture was left running"
            raise InstrumentError(self.role, "; ".join(wrong), why, "end other programs that use the board, run again")
        return self.snapshot()

    def arm(self) -> None:
        """Wait for triggers from now on."""
        _, mode = self._configured("arm")
        self._disarm()
        self._clipped = False
        mode.arm()

    def records(self, deadline_s: float) -> Iterator[RecordBlock]:
        """Yield what was captured, in order; raise ``DeadlineError`` if not all has come by ``deadline_s``.

        The capture is over, and its memory freed, when the iterator ends or is closed.
        """
        capture, mode = self._configured("records")
        if not mode.armed:
            why = "nothing is being captured, or the records were taken already"
            raise InstrumentError(self.role, "records came before arm", why, "call arm before the master trigger fires")
        return self._blocks(capture, mode, deadline_s)

    def clipped(self) -> bool:
        """Return whether any record since arming reached full scale, by the board's flag or by its codes."""
        return self._clipped

    def snapshot(self) -> Mapping[str, Setting]:
        """Return the programmed values, and what the board itself reports."""
        board, identity = self._board, self.identify()
        memory_samples, bits = board.channel_info()
        reported: dict[str, Setting] = {
            "model": identity.model,
            "serial": identity.serial,
            "firmware": identity.firmware,
            "board_options": board.capability(Capability.BOARD_OPTIONS_LOW),
            "dual_port_memory": board.has_dual_port_memory(),
            "memory_samples_per_channel": memory_samples,
            "bits_per_sample": bits,
            "clipped": self._clipped,
        }
        return reported | self._programmed()

    def self_test(self) -> None:
        """Do nothing: the vendor's interface has no self-test."""

    @property
    def line(self) -> str:
        """Empty: the board is reached within this process."""
        return ""

    def switch_off(self) -> None:
        """Do nothing: the board drives nothing by itself, and its capture is aborted by ``prove_off``."""

    def prove_off(self) -> str:
        """As ``make_safe``."""
        return self.make_safe()

    def make_safe(self) -> str:
        """Abort whatever is captured, free its memory, and return how that is known.

        Raises ``InstrumentError`` if the board stays busy.
        """
        try:
            self._disarm()
        finally:
            # Even where memory could not be freed the board is to stop.
            if self._board.busy():
                self._board.call(self._board.library.AlazarAbortCapture)
        if self._board.busy():
            remedy = "end the program, restart the machine"
            raise InstrumentError(self.role, "the board is still capturing", "the abort had no effect", remedy)
        return "idle by its own report"

    def close(self) -> None:
        """Abort what is running; the vendor's interface has nothing to close."""
        self._disarm()

    def _chosen_mode(self) -> Mode:
        dual = self._board.has_dual_port_memory()
        mode = self._wanted_mode or ("traditional" if dual else "single_port")
        if mode != "single_port" and not dual:
            what = f"acquisition mode {mode} needs dual-port memory"
            raise InstrumentError(self.role, what, "this board has none", 'acquisition_mode = "single_port"')
        return mode

    def _made_mode(self, mode: Mode, capture: Capture) -> SinglePortCapture | DualPortCapture:
        parts = self._board, self._clock, capture, self._allocate, tuple(_ranges_v(capture))
        return SinglePortCapture(*parts) if mode == "single_port" else DualPortCapture(*parts, npt=mode == "npt")

    def _program(self, capture: Capture) -> None:
        board, lib = self._board, self._board.library
        level = level_code(capture.trigger_level_v, self._model.trigger_range_v)
        rate_id = self._model.rate_ids[capture.sample_rate_hz]
        board.call(lib.AlazarSetCaptureClock, api.CLOCK_INTERNAL, rate_id, 0, 0)
        for channel, range_v in _ranges_v(capture).items():
            inputs = api.COUPLING_DC, self._model.range_ids[range_v], api.IMPEDANCE_50_OHM
            board.call(lib.AlazarInputControl, int(channel), *inputs)
            board.call(lib.AlazarSetBWLimit, int(channel), 0)
        external = api.ENGINE_J, api.SOURCE_EXTERNAL, api.SLOPE_POSITIVE, level
        unused = api.ENGINE_K, api.SOURCE_DISABLE, api.SLOPE_POSITIVE, ZERO_LEVEL_CODE
        board.call(lib.AlazarSetTriggerOperation, api.TRIGGER_OPERATION_J, *external, *unused)
        board.call(lib.AlazarSetExternalTrigger, api.COUPLING_DC, api.EXTERNAL_TRIGGER_5V)
        board.call(lib.AlazarSetTriggerDelay, max(0, capture.trigger_delay_samples))
        # Zero waits for ever: a record without its trigger would pass for an echo.
        board.call(lib.AlazarSetTriggerTimeOut, 0)
        board.call(lib.AlazarConfigureAuxIO, api.AUX_OUT_TRIGGER, 0)

    def _blocks(
        self, capture: Capture, mode: SinglePortCapture | DualPortCapture, deadline_s: float
    ) -> Iterator[RecordBlock]:
        try:
            for raw in mode.records(deadline_s):
                yield self._block(capture, raw)
        finally:
            # Here and not in the mode: a reader that stops half way closes this iterator, and no inner one.
            self._disarm()

    def _block(self, capture: Capture, raw: RawRecords) -> RecordBlock:
        model, range_v = self._model, capture.input_range_v
        values = samples.codes(raw.words, model)
        self._clipped = self._clipped or samples.any_at_full_scale(values, model) or self._board.input_clipped()
        volts = samples.volts_per_code(range_v, model), samples.volts_offset(range_v, model)
        time_s, monitor = raw.trigger_samples / capture.sample_rate_hz, _monitor(capture, values, model)
        return RecordBlock(raw.first_record, values[0], time_s, *volts, model.code_limits, monitor)

    def _programmed(self) -> dict[str, Setting]:
        if self._capture is None or self._mode is None:
            return {}
        programmed = {key: value for key, value in asdict(self._capture).items() if value is not None}
        return programmed | {
            "acquisition_mode": self._mode.name,
            "records_per_block": self._mode.records_per_block,
            "trigger_level_code": level_code(self._capture.trigger_level_v, self._model.trigger_range_v),
            "input_channels": "".join(channel.name for channel in _ranges_v(self._capture)),
            "input_coupling": "DC",
            "input_impedance_ohm": 50.0,
            "aux_output": "OUT_TRIGGER",
        }

    def _configured(self, action: str) -> tuple[Capture, SinglePortCapture | DualPortCapture]:
        if self._capture is None or self._mode is None:
            why = "nothing is programmed, or the last configure failed"
            raise InstrumentError(self.role, f"{action} came before configure", why, "call configure first")
        return self._capture, self._mode

    def _disarm(self) -> None:
        if self._mode is not None:
            self._mode.abort()


def _ranges_v(capture: Capture) -> dict[Channel, float]:
    """Return the range of every input that is recorded."""
    monitor = {} if capture.monitor_range_v is None else {Channel.B: capture.monitor_range_v}
    return {Channel.A: capture.input_range_v, **monitor}


def _monitor(capture: Capture, values: NDArray[np.int16], model: BoardModel) -> MonitorRecords | None:
    range_v = capture.monitor_range_v
    if range_v is None:
        return None
    return MonitorRecords(values[1], samples.volts_per_code(range_v, model), samples.volts_offset(range_v, model))
