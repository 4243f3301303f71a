"""Identity of the instruments: serial numbers and labels, compared with those of the bench file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

from drivers.interfaces import Instrument, InstrumentError
from hpe_rig.bench.bench_file import BenchFile
from hpe_rig.bench.instruments import ask_each


def reported_serials(bench: BenchFile, instruments: Sequence[Instrument]) -> dict[str, str | Exception]:
    """Return by role the serial number or label, or the error instead, of each instrument that must have one."""
    stated = [item for item in instruments if item.role in bench.serials]
    return ask_each(stated, lambda item: item.serial_number())


def require_serials(bench: BenchFile, instruments: Sequence[Instrument]) -> None:
    """Raise ``InstrumentError`` with every one of ``instruments`` that is not the one stated in the bench file."""
    reported = reported_serials(bench, instruments)
    serials = {}
    for role, serial in reported.items():
        if isinstance(serial, Exception):
            raise serial
        serials[role] = serial
    mistakes = serial_mistakes(bench, serials)
    if mistakes:
        why = "instruments or their addresses were exchanged; outputs are off, and nothing was programmed"
        other_remedy = "correct the addresses, or after an exchange run hpe-rig bench BENCH --identify"
        remedy = "; ".join(_swapped(bench, serials).values()) or other_remedy
        raise InstrumentError("bench", "; ".join(f"{role}: {text}" for role, text in mistakes.items()), why, remedy)


def serial_mistakes(bench: BenchFile, serials: Mapping[str, str]) -> dict[str, str]:
    """Return by role, in words, each of the reported ``serials`` that differs from the bench file's."""
    stated = bench.serials
    roles_stated = {serial: role for role, serial in stated.items()}
    mistakes = {}
    for role, serial in serials.items():
        if stated.get(role, serial) == serial:
            continue
        instrument = f"serial number {serial}" if serial else "an instrument without serial number and label"
        owner = f", which is that of {roles_stated[serial]}," if serial in roles_stated else ""
        text = f"{instrument}{owner} answers at {bench.address_text(role)}, expected {stated[role]}"
        roles = [name for name, number in serials.items() if number == stated[role]]
        addresses = " and ".join(f"{name} ({bench.address_text(name)})" for name in roles)
        mistakes[role] = text + (f", which answers as {addresses}" if roles else "")
    return mistakes


def serial_problems(bench: BenchFile, serials: Mapping[str, str]) -> dict[str, str]:
    """Return `serial_mistakes`; each of an exchanged pair comes with its remedy."""
    remedies = {role: text for pair, text in _swapped(bench, serials).items() for role in pair}
    mistakes = serial_mistakes(bench, serials)
    return {role: f"{text}. Try: {remedies[role]}" if role in remedies else text for role, text in mistakes.items()}


def shared_serials(serials: Mapping[str, str]) -> dict[str, str]:
    """Return by role, in words, each generator with a serial number that another role reported too."""
    roles: dict[str, str] = {}
    generators = {role: serial for role, serial in serials.items() if serial and role != "digitizer"}
    return {
        role: f"serial number {serial} answers for {first} too: one instrument has two addresses"
        for role, serial in generators.items()
        if (first := roles.setdefault(serial, role)) != role
    }


def _swapped(bench: BenchFile, serials: Mapping[str, str]) -> dict[tuple[str, str], str]:
    """Return by pair of roles, in words, the remedy for two instruments that answer for each other."""
    stated = bench.serials
    return {
        (first, second): f"{first} and {second} are swapped: exchange their addresses in the bench file"
        for first, second in combinations([role for role in serials if role in stated], 2)
        if serials[first] == stated[second] and serials[second] == stated[first]
    }
