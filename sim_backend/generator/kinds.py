"""Kinds of settings: numbers, keywords, switches and strings."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any

from sim_backend.generator.registers import Coerced, Registers, clipped, power_on
from sim_backend.generator.scpi_text import (
    INFINITE,
    ScpiError,
    boolean,
    keyword,
    number_with_unit,
    only_argument,
    real_reply,
    refuse_arguments,
)

Write = Callable[[Registers, tuple[str, ...]], Coerced]
Read = Callable[[Registers, tuple[str, ...]], str]
LimitsOf = Callable[[Registers], tuple[float, float]]
Shown = str | Callable[[Registers], Any]
"""The displayed value of a setting: a field of the registers by name, or a function of the registers."""


@dataclass(frozen=True, slots=True)
class SettingCommand:
    """Effect of one header on the registers of a channel."""

    command: Write | None
    """Effect of the header without ``?``; None if it exists only as a query."""
    query: Read | None
    """Reply to the header with ``?``; None if it exists only as a command."""
    accepts: str = ""
    """Description of the command's arguments."""

    def execute(self, state: Registers, arguments: tuple[str, ...]) -> Coerced:
        """Return the registers after the command, and the errors to queue, such as for a clipped value.

        Raises ``ScpiError`` -113 if the header exists only as a query.
        """
        if self.command is None:
            raise ScpiError(-113, "Undefined header")
        return self.command(state, arguments)

    def answer(self, state: Registers, arguments: tuple[str, ...]) -> str:
        """Return the reply to the query; raise ``ScpiError`` -113 if the header exists only as a command."""
        if self.query is None:
            raise ScpiError(-113, "Undefined header")
        return self.query(state, arguments)


def numeric(
    units: str,
    limits: LimitsOf,
    shown: Shown,
    put: Callable[[Registers, float], Coerced],
    infinite: bool = False,
    convert: Callable[[Registers, float, str], float] = lambda state, value, unit: value,
) -> SettingCommand:
    """Return a numeric setting in ``units`` between ``limits``, with its command and query.

    MIN, MAX, DEF and, if it may be ``infinite``, INF are accepted too. ``shown``: field or function with the displayed
    value. ``put`` sets the value; ``convert`` converts its unit to the displayed one.
    """
    get = getter(shown)

    def write(state: Registers, arguments: tuple[str, ...]) -> Coerced:
        """Return the registers after the command, and its errors."""
        text = only_argument(arguments)
        # MIN and MAX depend on the other settings, DEF on the model alone.
        value = min_or_max_keyword(text, limits(state))
        if value is None and text.upper() in ("DEF", "DEFAULT"):
            value = get(replace(power_on(state.model), angle_unit=state.angle_unit))
        if value is None and infinite and text.upper() in ("INF", "INFINITY"):
            value = float("inf")
        if value is None:
            value = convert(state, *number_with_unit(text, units))
        return put(state, float("inf") if infinite and value >= INFINITE else value)

    def read(state: Registers, arguments: tuple[str, ...]) -> str:
        """Return the reply to the query: the value, or its limit for MIN or MAX."""
        if not arguments:
            return real_reply(get(state))
        value = min_or_max_keyword(only_argument(arguments), limits(state))
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
    """Return a numeric setting, stored in ``field``, that is clipped to its limits.

    ``quantity`` names it in errors; ``settle`` adapts the settings that depend on it.
    """

    def put(state: Registers, value: float) -> Coerced:
        """Store the value, clipped, and adapt other settings."""
        value, errors = clipped(value, *limits(state), quantity)
        return settle(Coerced(replace(state, **{field: value}), errors))  # type: ignore[arg-type]

    return numeric(units, limits, field, put)


def choice(words: str, shown: Shown, put: Callable[[Registers, str], Coerced] | None = None) -> SettingCommand:
    """Return a setting with one of the keywords ``words``, written like ``SINusoid``."""
    return choice_of_model(", ".join(words.split()), lambda state: words.split(), shown, put)


def choice_of_model(
    accepts: str,
    words: Callable[[Registers], Iterable[str]],
    shown: Shown,
    put: Callable[[Registers, str], Coerced] | None = None,
) -> SettingCommand:
    """Return a setting with one of the keywords ``words``, which depend on the generator's model.

    ``shown``: field or function with the present keyword. ``put`` sets it (default: stores it in the field).
    """
    get, put = getter(shown), put or _setter(shown)
    return SettingCommand(
        lambda state, arguments: put(state, keyword(only_argument(arguments), words(state))),
        _without_arguments(lambda state: str(get(state))),
        accepts,
    )


def switch(shown: Shown, put: Callable[[Registers, bool], Coerced] | None = None) -> SettingCommand:
    """Return an on/off setting, with its command and query.

    ``shown``: field or function with the present state. ``put`` sets it (default: stores it in the field).
    """
    get, put = getter(shown), put or _setter(shown)
    return SettingCommand(
        lambda state, arguments: put(state, boolean(only_argument(arguments))),
        _without_arguments(lambda state: str(int(get(state)))),
        "ON, OFF",
    )


def min_or_max_keyword(text: str, limits: tuple[float, float]) -> float | None:
    """Return the limit that the keyword MIN or MAX stands for, None for another text."""
    low, high = limits
    return {"MIN": low, "MINIMUM": low, "MAX": high, "MAXIMUM": high}.get(text.upper())


def getter(shown: Shown) -> Callable[[Registers], Any]:
    """Return the function from registers to the displayed value."""
    return attrgetter(shown) if isinstance(shown, str) else shown


def _setter(shown: Shown) -> Callable[[Registers, Any], Coerced]:
    """Return the function that sets the field ``shown`` of the registers."""
    return lambda state, value: Coerced(replace(state, **{str(shown): value}))


def _without_arguments(show: Callable[[Registers], str]) -> Read:
    """Return a query that replies with ``show`` and refuses arguments."""

    def read(state: Registers, arguments: tuple[str, ...]) -> str:
        """Return the reply to the query."""
        refuse_arguments(arguments)
        return show(state)

    return read
