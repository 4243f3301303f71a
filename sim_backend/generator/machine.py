"""Machine: the generator as its commands see it.

The command tree needs the instrument and the instrument needs the tree; both depend on this protocol instead.
"""

from __future__ import annotations

from typing import Protocol

from sim_backend.generator.registers import Registers
from sim_backend.generator.state_names import StateNames
from sim_backend.generator.status import Status


class Machine(Protocol):
    """One generator: state, and the operations of commands that are no settings of a channel."""

    registers: Registers
    status: Status
    states: StateNames

    @property
    def message_waiting(self) -> bool:
        """Whether a reply waits to be read."""
        ...

    def reset(self) -> None: ...

    def trigger(self) -> None:
        """Start a burst, whatever the trigger source."""
        ...

    def trigger_from_bus(self) -> None:
        """Start a burst if the bus is the trigger source."""
        ...

    def wait(self) -> None:
        """Let time pass until the burst of a command ends."""
        ...

    def set_local(self, local: bool, over_any_bus: bool = False) -> None:
        """Enter or leave local mode; without ``over_any_bus`` RS-232 alone can do that."""
        ...
