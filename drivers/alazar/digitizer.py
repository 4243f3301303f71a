"""AlazarTech board as the bench's digitizer: external trigger, trigger output on AUX, echoes at channel A."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict
from typing import Final, Self, final

import numpy as np
from numpy.typing import NDArray

from drivers.alazar import api, samples
from drivers.alazar.api import Capability, Channel, Parameter
from drivers.alazar.board import AlazarBoard
from drivers.alazar.captures import CaptureJob, DualPortCapture, SinglePortCapture
from drivers.alazar.limits import Mode, level_code, mistakes
from drivers.alazar.models import BoardModel
from drivers.alazar.page_buffer import PageBuffer
from drivers.alazar.samples import RawRecords
from drivers.interfaces import Capture, Clock, Identity, InstrumentError, MonitorRecords, RecordBlock, Setting

UNSIGNED_FORMAT: Final = 0
ZERO_LEVEL_CODE: Final = 128


@final
class AlazarDigitizer:
    """Driver of one board.

    ``mode`` None selects traditional AutoDMA on boards with dual-port memory, single-port captures on others.
    ``allocate`` makes the page-aligned memory that the board writes into. A ``with`` statement ends by aborting the
    capture, verified, and freeing its memory.
    """

    def __init__(
        self,
        board: AlazarBoard,
        clock: Clock,
        mode: Mode | None = None,
        allocate: Callable[[int], PageBuffer] = PageBuffer,
    ) -> None:
        self._board = board
        self._model = board.model
        self._clock = clock
        self._mode = mode
        self._allocate = allocate
        self._settings: Capture | None = None
        self._capture: SinglePortCapture | DualPortCapture | None = None
        self._clipped = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.make_safe()

    @property
    def role(self) -> str:
        """The role of this instrument on the bench."""
        return self._board.role

    def identify(self) -> Identity:
        """Return the board's serial number and the versions of FPGA, driver and SDK."""
        board = self._board
        fpga = board.capability(Capability.FPGA_VERSION)
        firmware = f"FPGA {fpga}, driver {board.driver_version()}, SDK {board.sdk_version()}"
        return Identity("AlazarTech", self._model.name, str(board.capability(Capability.SERIAL_NUMBER)), firmware)

    def serial_number(self) -> str:
        """Return the board's serial number."""
        return self.identify().serial

    def configure(self, capture: Capture) -> None:
        """Program the board; raise one ``InstrumentError`` with every setting that it does not accept."""
        mode = self._supported_mode()
        fpga = self._board.capability(Capability.FPGA_VERSION)
        refusals = "; ".join(refusal.text for refusal in mistakes(capture, self._model, mode, fpga))
        if refusals:
            why = f"the {self._model.name} cannot do this, and nothing was sent to it"
            raise InstrumentError(self.role, refusals, why, "change the value in the scene or bench file")
        self._disarm()
        self._settings = self._capture = None
        self._program(capture)
        job = CaptureJob(self._board, self._clock, capture, tuple(_input_ranges_v(capture)), self._allocate)
        procedure = SinglePortCapture(job) if mode == "single_port" else DualPortCapture(job, npt=mode == "npt")
        procedure.prepare()
        self._settings, self._capture = capture, procedure

    def verify(self) -> Mapping[str, Setting]:
        """Return the ``snapshot``; raise ``InstrumentError`` if the board's report contradicts the settings.

        The vendor's interface has no read-back for most settings, so only the reported ones are compared.
        """
        _, capture = self._configured("verify")
        parameter = self._board.parameter
        expected = {
            "bits per sample": (self._model.code_bits, self._board.channel_info()[1]),
            "data format": (UNSIGNED_FORMAT, parameter(Parameter.DATA_FORMAT)),
            "capture running": (capture.armed, self._board.busy()),
            "buffers pending": (capture.buffers_posted(), parameter(Parameter.ASYNC_BUFFERS_PENDING)),
        }
        differences = [
            f"{name} expected {value:d}, the board reports {report:d}"
            for name, (value, report) in expected.items()
            if report is not None and report != value
        ]
        if differences:
            why, remedy = "another program changed the board, or a capture was left running", "end other programs"
            raise InstrumentError(self.role, "; ".join(differences), why, f"{remedy} that use the board, run again")
        return self.snapshot()

    def arm(self) -> None:
        """Start the capture, which waits for triggers."""
        _, capture = self._configured("arm")
        self._disarm()
        self._clipped = False
        capture.arm()

    def records(self, deadline_s: float) -> Iterator[RecordBlock]:
        """Yield the records in order; raise ``DeadlineError`` if not all have arrived by ``deadline_s``.

        The capture ends, and its memory is freed, when the iterator ends or is closed.
        """
        settings, capture = self._configured("records")
        if not capture.armed:
            why = "nothing is being captured, or the records were read already"
            raise InstrumentError(self.role, "records came before arm", why, "call arm before the master trigger fires")
        return self._blocks(settings, capture, deadline_s)

    def clipped(self) -> bool:
        """Return whether any record since arming reached full scale, by the board's flag or by its codes."""
        return self._clipped

    def snapshot(self) -> Mapping[str, Setting]:
        """Return the programmed values and the board's own report."""
        board, identity = self._board, self.identify()
        memory_samples, bits = board.channel_info()
        report: dict[str, Setting] = {
            "model": identity.model,
            "serial": identity.serial,
            "firmware": identity.firmware,
            "board_options": board.capability(Capability.BOARD_OPTIONS_LOW),
            "dual_port_memory": board.has_dual_port_memory(),
            "memory_samples_per_channel": memory_samples,
            "bits_per_sample": bits,
        }
        return report | self._programmed()

    def snapshot_and_errors(self) -> tuple[Mapping[str, Setting], tuple[str, ...]]:
        """Return the ``snapshot``; the board has no queue of errors."""
        return self.snapshot(), ()

    def self_test(self) -> None:
        """Do nothing: the vendor's interface has no self-test."""

    @property
    def bus(self) -> str:
        """Empty: the board is used within this process."""
        return ""

    def switch_off(self) -> None:
        """Do nothing: the board has no output to switch, and ``prove_off`` aborts its capture."""

    def prove_off(self) -> str:
        """As ``make_safe``."""
        return self.make_safe()

    def make_safe(self) -> str:
        """Abort the capture, free its memory, and return how the end is proven.

        Raises ``InstrumentError`` if the board stays busy.
        """
        try:
            self._disarm()
        finally:
            # The board must stop even if memory could not be freed.
            if self._board.busy():
                self._board.call(self._board.library.AlazarAbortCapture)
        if self._board.busy():
            remedy = "end the program, restart the machine"
            raise InstrumentError(self.role, "the board is still capturing", "the abort had no effect", remedy)
        return "idle by its own report"

    def close(self) -> None:
        """Abort the capture; the vendor's interface has nothing to close."""
        self._disarm()

    def _supported_mode(self) -> Mode:
        dual_port = self._board.has_dual_port_memory()
        mode = self._mode or ("traditional" if dual_port else "single_port")
        if mode != "single_port" and not dual_port:
            what = f"acquisition mode {mode} needs dual-port memory"
            raise InstrumentError(self.role, what, "this board has none", 'acquisition_mode = "single_port"')
        return mode

    def _program(self, settings: Capture) -> None:
        board, lib, model = self._board, self._board.library, self._model
        board.call(lib.AlazarSetCaptureClock, api.CLOCK_INTERNAL, model.rate_ids[settings.sample_rate_hz], 0, 0)
        for channel, range_v in _input_ranges_v(settings).items():
            range_id = model.range_ids[range_v]
            board.call(lib.AlazarInputControl, int(channel), api.COUPLING_DC, range_id, api.IMPEDANCE_50_OHM)
            board.call(lib.AlazarSetBWLimit, int(channel), 0)
        level = level_code(settings.trigger_level_v, model.trigger_range_v)
        external = api.ENGINE_J, api.SOURCE_EXTERNAL, api.SLOPE_POSITIVE, level
        unused = api.ENGINE_K, api.SOURCE_DISABLE, api.SLOPE_POSITIVE, ZERO_LEVEL_CODE
        board.call(lib.AlazarSetTriggerOperation, api.TRIGGER_OPERATION_J, *external, *unused)
        board.call(lib.AlazarSetExternalTrigger, api.COUPLING_DC, model.trigger_range_id)
        board.call(lib.AlazarSetTriggerDelay, max(0, settings.trigger_delay_samples))
        # Zero waits for ever: after a time-out the board would record without a trigger.
        board.call(lib.AlazarSetTriggerTimeOut, 0)
        board.call(lib.AlazarConfigureAuxIO, api.AUX_OUT_TRIGGER, 0)

    def _blocks(
        self, settings: Capture, capture: SinglePortCapture | DualPortCapture, deadline_s: float
    ) -> Iterator[RecordBlock]:
        try:
            for raw in capture.records(deadline_s):
                yield self._block(settings, raw)
        finally:
            # A reader that stops early closes this iterator, not the one of the capture.
            self._disarm()

    def _block(self, settings: Capture, raw: RawRecords) -> RecordBlock:
        model, range_v = self._model, settings.input_range_v
        codes = samples.codes(raw.words, model)
        self._clipped = self._clipped or samples.any_at_full_scale(codes, model) or self._board.input_clipped()
        scale = samples.volts_per_code(range_v, model), samples.volts_offset(range_v, model)
        time_s, monitor = raw.trigger_samples / settings.sample_rate_hz, _monitor(settings, codes, model)
        return RecordBlock(raw.first_record, codes[0], time_s, *scale, model.code_limits, monitor)

    def _programmed(self) -> dict[str, Setting]:
        if self._settings is None or self._capture is None:
            return {}
        settings = {key: value for key, value in asdict(self._settings).items() if value is not None}
        return settings | {
            "acquisition_mode": self._capture.name,
            "records_per_block": self._capture.records_per_block,
            "trigger_level_code": level_code(self._settings.trigger_level_v, self._model.trigger_range_v),
            "input_channels": "".join(channel.name for channel in _input_ranges_v(self._settings)),
            "input_coupling": "DC",
            "input_impedance_ohm": 50.0,
            "aux_output": "OUT_TRIGGER",
        }

    def _configured(self, action: str) -> tuple[Capture, SinglePortCapture | DualPortCapture]:
        if self._settings is None or self._capture is None:
            why = "nothing is programmed, or the last configure failed"
            raise InstrumentError(self.role, f"{action} came before configure", why, "call configure first")
        return self._settings, self._capture

    def _disarm(self) -> None:
        if self._capture is not None:
            self._capture.abort()


def _input_ranges_v(settings: Capture) -> dict[Channel, float]:
    """Return the range of every recorded input."""
    monitor = {} if settings.monitor_range_v is None else {Channel.B: settings.monitor_range_v}
    return {Channel.A: settings.input_range_v, **monitor}


def _monitor(settings: Capture, codes: NDArray[np.int16], model: BoardModel) -> MonitorRecords | None:
    range_v = settings.monitor_range_v
    if range_v is None:
        return None
    return MonitorRecords(codes[1], samples.volts_per_code(range_v, model), samples.volts_offset(range_v, model))
