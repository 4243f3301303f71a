"""Error queue and status registers of a 33250A (docs/explanation/instruments.md, 1.5 and 1.6)."""

from __future__ import annotations

QUEUE_DEPTH = 20
STB_ERRORS, STB_MESSAGE, STB_EVENT = 4, 16, 32
ESR_COMPLETE, ESR_QUERY, ESR_DEVICE, ESR_EXECUTION, ESR_COMMAND, ESR_POWER_ON = 1, 4, 8, 16, 32, 128
_EVENT_BY_HUNDREDS = {1: ESR_COMMAND, 2: ESR_EXECUTION, 3: ESR_DEVICE, 4: ESR_QUERY}


class Status:
    """The status of one instrument since power-on."""

    def __init__(self) -> None:
        """Start with the state after power-on: no errors, no event enabled."""
        self._errors: list[tuple[int, str]] = []
        self._events = ESR_POWER_ON
        self.event_mask = 0
        self.has_external_reference = False

    def queue(self, number: int, text: str) -> None:
        """Append an error; the 21st turns the newest into -350 and is lost."""
        # Negative numbers are SCPI errors by hundreds, positive ones are device errors.
        self._events |= _EVENT_BY_HUNDREDS[-number // 100] if number < 0 else ESR_DEVICE
        if len(self._errors) < QUEUE_DEPTH:
            self._errors.append((number, text))
        else:
            self._errors[-1] = (-350, "Queue overflow")

    def next_error(self) -> str:
        """Remove and return the oldest error."""
        number, text = self._errors.pop(0) if self._errors else (0, "No error")
        return f'{number:+d},"{text}"'

    def clear(self) -> None:
        """Empty error queue and event register."""
        self._errors.clear()
        self._events = 0

    def complete(self) -> None:
        """Set the operation-complete bit of the event register."""
        self._events |= ESR_COMPLETE

    def events(self) -> str:
        """Return and clear the event register."""
        value, self._events = self._events, 0
        return f"{value:+d}"

    def questionable(self) -> str:
        """Return the condition register of the questionable status: bit 9 if locked to the 10 MHz input."""
        return "+512" if self.has_external_reference else "+0"

    def byte(self, message_waiting: bool) -> str:
        """Return the status byte (*STB?): the presence of errors, replies and enabled events."""
        value = (STB_ERRORS if self._errors else 0) | (STB_MESSAGE if message_waiting else 0)
        value |= STB_EVENT if self._events & self.event_mask else 0
        return f"{value:+d}"
