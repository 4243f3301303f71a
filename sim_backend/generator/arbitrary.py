"""Arbitrary waveforms in memory: names, points and attributes; they have no output in the twin."""

from __future__ import annotations

import re
from array import array
from collections.abc import Sequence

import numpy as np

from sim_backend.generator.scpi_text import (
    ScpiError,
    not_simulated,
    number_with_unit,
    only_argument,
    real_reply,
    refuse_arguments,
    unquoted,
)

BUILT_IN = ("EXP_RISE", "EXP_FALL", "NEG_RAMP", "SINC", "CARDIAC")
VOLATILE = "VOLATILE"
SLOTS = 4
MAX_POINTS = 65_536
MIN_POINTS = 8
MAX_NAMES = 16
"""Waveforms in the volatile memory of the 33500 and 33600 series (assumed)."""
_NAME = re.compile(r"[A-Z][A-Z0-9_]*", re.ASCII)
MAX_NAME = 12


def waveform_name(text: str) -> str:
    """Return the name in ``text``, which may be in quotes, in capitals.

    Raises ``ScpiError`` -148 for an invalid name, -112 for a long one.
    """
    name = unquoted(text) if text[:1] in ('"', "'") else text
    if not _NAME.fullmatch(name.upper()):
        raise ScpiError(-148, "Character data not allowed")
    if len(name) > MAX_NAME:
        raise ScpiError(-112, "Program mnemonic too long")
    return name.upper()


class WaveformMemory:
    """Waveforms by name: one in volatile memory, four in non-volatile memory, five built in."""

    def __init__(self) -> None:
        self._points: dict[str, array[float]] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """All selectable waveforms."""
        return (*((VOLATILE,) if VOLATILE in self._points else ()), *BUILT_IN, *self.stored)

    @property
    def stored(self) -> tuple[str, ...]:
        """The user's waveforms in non-volatile memory."""
        return tuple(name for name in self._points if name != VOLATILE)

    def download(self, arguments: tuple[str, ...], scale: float) -> None:
        """Store points in volatile memory; the first argument is the destination, ``scale`` the full-scale number."""
        if len(arguments) < 2:
            raise ScpiError(-109, "Missing parameter")
        if arguments[0].upper() != VOLATILE:
            raise ScpiError(-224, "Illegal parameter value")
        self._points[VOLATILE] = _scaled(arguments[1:], scale)

    def download_named(self, arguments: tuple[str, ...], scale: float) -> None:
        """Store points in volatile memory under the name in the first argument (33500 and 33600 series).

        ``scale``: the full-scale number.
        """
        if len(arguments) < 2:
            raise ScpiError(-109, "Missing parameter")
        name = waveform_name(arguments[0])
        if name in self._points:
            raise ScpiError(786, "Specified arb waveform already exists")
        if len(arguments) <= MIN_POINTS:
            raise ScpiError(-222, "Data out of range; number of points")
        if len(self._points) == MAX_NAMES:
            raise ScpiError(781, "Not enough memory to store new arb waveform")
        self._points[name] = _scaled(arguments[1:], scale)

    def clear(self) -> None:
        """Delete all waveforms of the user."""
        self._points.clear()

    def copy(self, arguments: tuple[str, ...]) -> None:
        """Copy the volatile waveform to another name, if there is room."""
        name = waveform_name(arguments[0] if arguments else only_argument(arguments))
        refuse_arguments(arguments[2:])
        if name in BUILT_IN:
            raise ScpiError(782, "Cannot overwrite a built-in waveform")
        self._existing(VOLATILE)
        if name not in self.stored and len(self.stored) == SLOTS:
            raise ScpiError(781, "Not enough memory to store new arb waveform; no more than 4 user waveforms")
        self._points[name] = self._points[VOLATILE]

    def delete(self, name: str, active: str) -> None:
        """Delete a waveform; raise ``ScpiError`` if it is built in or ``active``."""
        if name in BUILT_IN:
            raise ScpiError(786, "Cannot delete a built-in arb waveform")
        if name == active:
            raise ScpiError(787, "Cannot delete the currently selected active arb waveform")
        del self._points[self._existing(name)]

    def delete_all(self, active: str) -> None:
        """Delete all waveforms of the user except the ``active`` one."""
        self._points = {name: points for name, points in self._points.items() if name == active}

    def select(self, text: str) -> str:
        """Return the name of an existing waveform; raise ``ScpiError`` 785 for another."""
        return self._existing(waveform_name(text))

    def attribute(self, attribute: str, name: str) -> str:
        """Return the reply to a query of a waveform: average, crest factor, number of points or peak-to-peak value."""
        if self._existing(name) in BUILT_IN:
            raise not_simulated("the points of built-in waveforms")
        points = np.frombuffer(self._points[name], np.float64)
        if attribute == "POINTS":
            return f"{points.size:+d}"
        rms = float(np.sqrt(np.mean(points**2)))
        peak = float(np.max(np.abs(points)))
        # The crest factor, peak over rms, is the remaining attribute.
        values = {"AVERAGE": float(np.mean(points)), "PTPEAK": float(np.ptp(points))}
        return real_reply(values.get(attribute, peak / rms if rms else 0.0))

    def _existing(self, name: str) -> str:
        """Return ``name``; raise ``ScpiError`` 785 if no waveform has it."""
        if name not in self.names:
            raise ScpiError(785, "Specified arb waveform does not exist")
        return name


def _scaled(arguments: Sequence[str], scale: float) -> array[float]:
    """Return the points in ``arguments`` relative to full scale, ``scale``.

    Raises ``ScpiError`` for too many points or one beyond ±1.
    """
    if any(argument.startswith("#") for argument in arguments):
        raise not_simulated("binary blocks, send the points as numbers")
    if len(arguments) > MAX_POINTS:
        raise ScpiError(-223, "Too much data")
    points = array("d", (number_with_unit(argument, "")[0] / scale for argument in arguments))
    if max(points) > 1.0 or min(points) < -1.0:
        raise ScpiError(-222, "Data out of range; arbitrary waveform point")
    return points
