"""Provenance of a measurement: who, when and on which machine; outside of what a simulated run repeats bit for bit."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Provenance:
    """When a run started and ended, ISO 8601 with the offset from UTC, and where; "" is what nobody knows.

    ``drivers``: the packages below the instruments' drivers with their versions. What instruments and boards say of
    themselves, firmware and driver among it, stands with their settings.
    """

    started: str = ""
    ended: str = ""
    host: str = ""
    user: str = ""
    drivers: str = ""


UNKNOWN = Provenance()
"""Of files of earlier releases, and of what no run was made for."""
