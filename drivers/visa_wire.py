"""A wire over VISA: GPIB, RS-232, raw TCP socket, HiSLIP and VXI-11, through a vendor's VISA or pyvisa-py."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Final, final

if TYPE_CHECKING:
    from pyvisa import ResourceManager
    from pyvisa.resources import MessageBasedResource

# Factory setting of the 33250A's RS-232 interface; 8 data bits, no parity and 1 stop bit are VISA's own default.
SERIAL_BAUD: Final = 57600


@final
class VisaWire:
    """One text connection; replies without line end.

    Raises ``ConnectionError`` when the connection cannot be opened or is lost, ``TimeoutError`` from ``read`` when
    no reply comes within ``timeout_s``. ``backend`` is pyvisa's library choice ("" is the vendor's, else "@py").
    """

    def __init__(self, address: str, timeout_s: float = 2.0, backend: str = "") -> None:
        import pyvisa

        self.address = address
        self._visa_error = pyvisa.VisaIOError
        self._timeout_code = pyvisa.constants.StatusCode.error_timeout
        try:
            self._resource = _open(_resource_manager(backend), address)
            self._prepare(timeout_s)
        except (pyvisa.VisaIOError, OSError, ValueError) as error:
            raise ConnectionError(
                f"cannot open {address!r}: {error}; is the address right and the device on?"
            ) from error

    def write(self, message: str) -> None:
        """Send ``message`` and a line feed."""
        try:
            self._resource.write(message)
        except (self._visa_error, OSError) as error:
            raise ConnectionError(f"cannot write to {self.address!r}: {error}") from error

    def read(self) -> str:
        """Return one reply line."""
        try:
            return self._resource.read().rstrip("\r\n")
        except (self._visa_error, OSError) as error:
            if getattr(error, "error_code", None) == self._timeout_code:
                raise TimeoutError(f"no reply from {self.address!r} within {self.timeout_s:g} s") from error
            raise ConnectionError(f"cannot read from {self.address!r}: {error}") from error

    @property
    def timeout_s(self) -> float:
        """How long ``read`` waits."""
        return float(self._resource.timeout) / 1e3

    def close(self) -> None:
        """Close the connection; closing one that is gone already is no error."""
        with suppress(self._visa_error, OSError):
            self._resource.close()

    def _prepare(self, timeout_s: float) -> None:
        import pyvisa

        self._resource.timeout = timeout_s * 1e3
        self._resource.write_termination = "\n"
        # A Prologix adapter has no read terminator to set; there the line end is cut in read().
        with suppress(self._visa_error):
            self._resource.read_termination = "\n"
        if isinstance(self._resource, pyvisa.resources.SerialInstrument):
            self._resource.baud_rate = SERIAL_BAUD
            self._resource.flow_control = pyvisa.constants.ControlFlow.dtr_dsr
            # Over RS-232 the instrument refuses commands until it is told to leave local mode.
            self.write("SYST:REM")


def _resource_manager(backend: str) -> ResourceManager:
    import pyvisa

    try:
        return pyvisa.ResourceManager(backend)
    except (ValueError, OSError):
        return pyvisa.ResourceManager("@py")


def _open(manager: ResourceManager, address: str) -> MessageBasedResource:
    import pyvisa

    resource = manager.open_resource(address)
    if isinstance(resource, pyvisa.resources.MessageBasedResource):
        return resource
    resource.close()
    raise ValueError(f"{type(resource).__name__} carries no text messages")
