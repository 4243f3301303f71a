"""pyserial's ``socket://`` by the name that pyvisa-py asks for on Windows, where COM precedes every serial port."""

from __future__ import annotations

from serial.urlhandler import protocol_socket


class Serial(protocol_socket.Serial):  # type: ignore[misc]
    """A serial line behind a TCP socket."""

    def from_url(self, url: str) -> tuple[str, int]:
        """Return host and port in ``url``."""
        place: tuple[str, int] = super().from_url(url.removeprefix("COM"))
        return place
