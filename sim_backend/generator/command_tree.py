"""Command tree: every header of every model with its effect, as one table.

docs/reference/command-tree.md is printed from it by docs/_build_tools/command_tree.py.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache

from sim_backend.generator.apply import apply_forms
from sim_backend.generator.commands import settings_of
from sim_backend.generator.headers import HeaderTable
from sim_backend.generator.kinds import SettingCommand
from sim_backend.generator.machine import Machine
from sim_backend.generator.models import MODELS, Model
from sim_backend.generator.scpi_text import ScpiError, keyword, only_argument, refuse_arguments, whole_number

Execute = Callable[[Machine, tuple[str, ...]], None]
Answer = Callable[[Machine, tuple[str, ...]], str]

SCPI_VERSION = "1999.0"
"""From the manual; an emulator that was compared with hardware answers 1994.0 (unresolved)."""


@dataclass(frozen=True, slots=True)
class Action:
    """A header that is no setting of a channel, as a command and as a query; None if there is no such form.

    ``accepts`` and ``query_accepts`` describe the arguments of the two forms in words; empty if there are none.
    """

    command: Execute | None = None
    query: Answer | None = None
    accepts: str = ""
    query_accepts: str = ""

    def execute(self, instrument: Machine, query: bool, arguments: tuple[str, ...]) -> str | None:
        """Execute the command and return None, or with ``query`` return the reply to the query.

        Raises ``ScpiError`` -108 for arguments if it takes none, and -113 if the header has no command, or no query.
        """
        takes_arguments = self.query_accepts if query else self.accepts
        if not takes_arguments:
            refuse_arguments(arguments)
        if query and self.query is not None:
            return self.query(instrument, arguments)
        if query or self.command is None:
            raise ScpiError(-113, "Undefined header")
        self.command(instrument, arguments)
        return None


def _fixed(reply: str) -> Answer:
    return lambda instrument, arguments: reply


def _wait_and_answer(instrument: Machine, arguments: tuple[str, ...]) -> str:
    """Wait until the burst of a command has ended, and reply "1" (*OPC?)."""
    instrument.wait()
    return "1"


def _beep(instrument: Machine, arguments: tuple[str, ...]) -> None:
    """Do nothing: the beeper is not simulated."""


def _enable_events(instrument: Machine, arguments: tuple[str, ...]) -> None:
    """Set which events the status byte reports (*ESE)."""
    instrument.status.event_mask = whole_number(only_argument(arguments), 0, 255)


COMMON: Mapping[str, Action] = {
    "*IDN": Action(query=lambda instrument, arguments: instrument.registers.model.identity),
    "*RST": Action(lambda instrument, arguments: instrument.reset()),
    "*CLS": Action(lambda instrument, arguments: instrument.status.clear()),
    "*TRG": Action(lambda instrument, arguments: instrument.trigger_from_bus()),
    "*WAI": Action(lambda instrument, arguments: instrument.wait()),
    "*OPC": Action(lambda instrument, arguments: instrument.status.complete(), _wait_and_answer),
    "*TST": Action(query=_fixed("+0")),
    "*ESR": Action(query=lambda instrument, arguments: instrument.status.events()),
    "*STB": Action(query=lambda instrument, arguments: instrument.status.byte(instrument.message_waiting)),
    "*ESE": Action(_enable_events, lambda instrument, arguments: f"{instrument.status.event_mask:+d}", "0 to 255"),
}

SYSTEM: Mapping[str, Action] = {
    "SYSTem:ERRor[:NEXT]": Action(query=lambda instrument, arguments: instrument.status.next_error()),
    "SYSTem:VERSion": Action(query=_fixed(SCPI_VERSION)),
    "SYSTem:BEEPer[:IMMediate]": Action(_beep),
    "SYSTem:LOCal": Action(lambda instrument, arguments: instrument.set_local(True)),
    "SYSTem:REMote": Action(lambda instrument, arguments: instrument.set_local(False)),
    "SYSTem:RWLock": Action(lambda instrument, arguments: instrument.set_local(False)),
    "STATus:QUEStionable:CONDition": Action(query=lambda instrument, arguments: instrument.status.questionable()),
    "MEMory:STATe:NAME": Action(
        lambda instrument, arguments: instrument.states.rename(arguments),
        lambda instrument, arguments: instrument.states.name(arguments),
        "0 to 4, name",
        "0 to 4",
    ),
    "TRIGger<n>[:SEQuence][:IMMediate]": Action(lambda instrument, arguments: instrument.trigger()),
}


OF_SERIES: Mapping[str, Action] = {
    "*OPT": Action(query=_fixed("0")),
    "[SOURce<n>:]PHASe:SYNChronize": Action(lambda instrument, arguments: None),
}
"""Commands of the 33500 and the 33600 series alone (assumed: the reply to ``*OPT?``)."""

ON_LAN: Mapping[str, Action] = {
    "SYSTem:COMMunicate:RLSTate": Action(
        lambda instrument, arguments: instrument.set_local(
            keyword(only_argument(arguments), ("LOCal", "REMote", "RWLock")) == "LOC", over_any_bus=True
        ),
        accepts="LOCal, REMote, RWLock",
    )
}
"""Commands of the models with a network connector."""

NOT_SIMULATED = (
    *(f"[SOURce<n>:]{name}" for name in ("AM", "FM", "PM", "PWM", "FSKey", "SWEep", "MARKer", "DATA")),
    *(f"[SOURce<n>:]FREQuency:{name}" for name in ("STARt", "STOP", "CENTer", "SPAN")),
    *(f"[SOURce<n>:]FUNCtion[:SHAPe]:{name}" for name in ("USER", "ARBitrary")),
    *("[SOURce<n>:]BURSt:GATE", "[SOURce<n>:]PHASe:UNLock", "TRIGger<n>:TIMer", "TRIGger<n>:COUNt", "INITiate<n>"),
    *("CALibration", "DISPlay", "FORMat", "MEMory", "STATus", "*SAV", "*RCL", "*LRN", "*SRE", "*PSC"),
)
"""Beginnings of headers that instruments have and the twin refuses with -241."""

Entry = SettingCommand | Action
ALLOWED_IN_LOCAL = (SYSTEM["SYSTem:REMote"], SYSTEM["SYSTem:RWLock"], *ON_LAN.values())
"""Commands that an instrument on RS-232 accepts in local mode."""


def tree_of(model: Model) -> Mapping[str, Entry]:
    """Return all commands of ``model``, by the form of their header such as ``[SOURce<n>:]FREQuency[:CW]``."""
    # Models with numbered channels are those of the 33500 and 33600 series; the 33250A alone has no network.
    of_series = OF_SERIES if model.channels else {}
    network = {} if model.name == "33250A" else ON_LAN
    return {**COMMON, **apply_forms(model.functions), **settings_of(model), **SYSTEM, **of_series, **network}


@cache
def table_of(name: str) -> HeaderTable[Entry]:
    """Return the commands of a model by the name in its identity."""
    model = next(model for model in MODELS.values() if model.name == name)
    return HeaderTable(tree_of(model), NOT_SIMULATED, model.channels)
