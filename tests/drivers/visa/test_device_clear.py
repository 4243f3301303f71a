"""Device clear: sent once after a missing reply, where the interface may be waiting to send it."""

from __future__ import annotations

import pytest
import pyvisa

from drivers.visa import PrologixAdapter, VisaConnection
from drivers.visa.resources import _has_device_clear
from sim_backend.transports import Emulator
from sim_backend.transports.prologix import PrologixAdapter as SimulatedAdapter

TIMEOUT_S = 0.3


@pytest.mark.parametrize(("transport", "expected"), [("vxi11", 1), ("hislip", 0)])
def test_a_missing_reply_is_followed_by_one_clear_on_the_bus_that_needs_it(
    scripted, monkeypatch: pytest.MonkeyPatch, transport, expected: int
) -> None:
    cleared: list[str] = []
    clear = pyvisa.resources.TCPIPInstrument.clear

    def recorded(resource: pyvisa.resources.TCPIPInstrument) -> None:
        cleared.append(resource.resource_name)
        clear(resource)

    monkeypatch.setattr(pyvisa.resources.TCPIPInstrument, "clear", recorded)
    with Emulator(transport, lambda role, over_serial: scripted(), ("x",)) as emulator:
        connection = VisaConnection(emulator.served["x"].address, TIMEOUT_S, backend="@py")
        connection.write("*IDN?")
        assert "33250A" in connection.read()
        assert cleared == []
        connection.write("*OPT?")
        with pytest.raises(TimeoutError):
            connection.read()
        for _ in range(2):
            connection.write("*IDN?")
            assert "33250A" in connection.read()
        assert len(cleared) == expected
        connection.close()


def test_a_missing_reply_behind_a_prologix_adapter_is_followed_by_one_clear_of_its_instrument(
    scripted, monkeypatch: pytest.MonkeyPatch
) -> None:
    commands: list[tuple[int, bytes]] = []
    carry_out = SimulatedAdapter._adapter

    def recorded(adapter: SimulatedAdapter, addressed: int, line: bytes) -> bytes:
        commands.append((addressed, line))
        return carry_out(adapter, addressed, line)

    monkeypatch.setattr(SimulatedAdapter, "_adapter", recorded)
    with Emulator("prologix", lambda role, over_serial: scripted(), ("x", "y")) as emulator:
        adapter = PrologixAdapter(emulator.served["x"].interface or "", TIMEOUT_S)
        first, second = (
            VisaConnection(emulator.served[role].address, TIMEOUT_S, adapter=adapter) for role in ("x", "y")
        )
        first.write("*OPT?")
        with pytest.raises(TimeoutError):
            first.read()
        for connection in (second, first, first):
            connection.write("*IDN?")
            assert "33250A" in connection.read()
        adapter.close()
    assert [address for address, line in commands if line == b"++clr"] == [10]


def test_gpib_and_usb_instruments_have_a_device_clear_and_serial_lines_have_none() -> None:
    kinds = pyvisa.resources
    # No bus is installed here: these objects are never opened.
    for kind, expected in ((kinds.GPIBInstrument, True), (kinds.USBInstrument, True), (kinds.SerialInstrument, False)):
        resource = object.__new__(kind)
        resource._session = None
        assert _has_device_clear(resource) == expected
