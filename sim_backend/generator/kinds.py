"""Kinds of settings: numbers, keywords, switches and strings, each as what a header writes, reads and accepts."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any

from sim_backend.generator.registers import Coerced, Registers, clipped, power_on
from sim_backend.generator.scpi_text import INFINITE, ScpiError, boolean, keyword, none_of, number, one, real_reply

Write = Callable[[Registers, tuple[str, ...]], Coerced]
Read = Callable[[Registers, tuple[str, ...]], str]
LimitsOf = Callable[[Registers], tuple[float, float]]
# What is shown of the registers: a field by its name, or what a function makes of them.
Shown = str | Callable[[Registers], Any]


@dataclass(frozen=True, slots=True)
class SettingCommand:
    """What one header does to the registers of a channel; None where the form without or with ``?`` does not exist.

    ``accepts`` says in words what may follow the header.
    """

    write: Write | None
    read: Read | None
    accepts: str = ""

    @property
    def takes(self) -> str | None:
        """What may follow the header as a command; None where there is no such form."""
        return None if self.write is None else self.accepts

    @property
    def asks(self) -> str | None:
        """What may follow the header as a query; None where there is no such form."""
        return None if self.read is None else ""

    def carried_out(self, state: Registers, arguments: tuple[str, ...]) -> Coerced:
        """Return the registers after the command; raise ``ScpiError`` -113 where it exists as a query alone."""
        if self.write is None:
            raise ScpiError(-113, "Undefined header")
        return self.write(state, arguments)

    def answer(self, state: Registers, arguments: tuple[str, ...]) -> str:
        """Return the reply to the query; raise ``ScpiError`` -113 where there is none."""
        if self.read is None:
            raise ScpiError(-113, "Undefined header")
        return self.read(state, arguments)


def numeric(
    units: str,
    limits: LimitsOf,
    shown: Shown,
    put: Callable[[Registers, float], Coerced],
    infinite: bool = False,
    convert: Callable[[Registers, float, str], float] = lambda state, value, unit: value,
) -> SettingCommand:
    """Return a number in ``units`` between ``limits``; ``put`` sets it, ``convert`` turns its unit into the one shown.

    MIN, MAX and DEF may stand for it, INF where it may be ``infinite``.
    """
    get = getter(shown)

    def write(state: Registers, arguments: tuple[str, ...]) -> Coerced:
        text = one(arguments)
        value = extreme(text, limits(state))
        if value is None and text.upper() in ("DEF", "DEFAULT"):
            value = get(replace(power_on(state.model), angle_unit=state.angle_unit))
        if value is None and infinite and text.upper() in ("INF", "INFINITY"):
            value = float("inf")
        if value is None:
            value = convert(state, *number(text, units))
        return put(state, float("inf") if infinite and value >= INFINITE else value)

    def read(state: Registers, arguments: tuple[str, ...]) -> str:
        if not arguments:
            return real_reply(get(state))
        value = extreme(one(arguments), limits(state))
        if value is None:
            raise ScpiError(-224, "Illegal parameter value")
        return real_reply(value)

    unit = f" in {', '.join(units.split())}" if units else ""
    return SettingCommand(write, read, f"number{unit}, MIN, MAX, DEF" + (", INF" if infinite else ""))


def clipping(
    units: str,
    limits: LimitsOf,
    field: str,
    quantity: str,
    settle: Callable[[Coerced], Coerced] = lambda coerced: coerced,
) -> SettingCommand:
    """Return a number that is clipped to its limits; ``settle`` fits the other settings to it."""

    def put(state: Registers, value: float) -> Coerced:
        value, errors = clipped(value, *limits(state), quantity)
        return settle(Coerced(replace(state, **{field: value}), errors))  # type: ignore[arg-type]

    return numeric(units, limits, field, put)


def choice(words: str, shown: Shown, put: Callable[[Registers, str], Coerced] | None = None) -> SettingCommand:
    """Return a keyword, one of ``words``, which are written like ``SINusoid``."""
    return choice_of_model(", ".join(words.split()), lambda state: words.split(), shown, put)


def choice_of_model(
    accepts: str,
    words: Callable[[Registers], Iterable[str]],
    shown: Shown,
    put: Callable[[Registers, str], Coerced] | None = None,
) -> SettingCommand:
    """Return a keyword out of those that the model of the registers knows."""
    get, put = getter(shown), put or _setter(shown)
    return SettingCommand(
        lambda state, arguments: put(state, keyword(one(arguments), words(state))),
        _plain(lambda state: str(get(state))),
        accepts,
    )


def switch(shown: Shown, put: Callable[[Registers, bool], Coerced] | None = None) -> SettingCommand:
    """Return a switch."""
    get, put = getter(shown), put or _setter(shown)
    return SettingCommand(
        lambda state, arguments: put(state, boolean(one(arguments))),
        _plain(lambda state: str(int(get(state)))),
        "ON, OFF",
    )


def extreme(text: str, limits: tuple[float, float]) -> float | None:
    """Return the limit that the keyword in ``text`` stands for; None for another text."""
    low, high = limits
    return {"MIN": low, "MINIMUM": low, "MAX": high, "MAXIMUM": high}.get(text.upper())


def getter(shown: Shown) -> Callable[[Registers], Any]:
    """Return the function that shows something of the registers."""
    return attrgetter(shown) if isinstance(shown, str) else shown


def _setter(shown: Shown) -> Callable[[Registers, Any], Coerced]:
    return lambda state, value: Coerced(replace(state, **{str(shown): value}))


def _plain(show: Callable[[Registers], str]) -> Read:
    def read(state: Registers, arguments: tuple[str, ...]) -> str:
        none_of(arguments)
        return show(state)

    return read
