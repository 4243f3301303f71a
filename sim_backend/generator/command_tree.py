"""Command tree: every header of every model with its effect, as one table.

docs/reference/command-tree.md is printed from it by docs/_build_tools/command_tree.py.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache

from sim_backend.generator.apply import apply_forms
from sim_backend.generator.arbitrary import BUILT_IN, MAX_POINTS, MIN_POINTS, SLOTS, waveform_name
from sim_backend.generator.commands import settings_of
from sim_backend.generator.headers import HeaderTable
from sim_backend.generator.inactive import with_inactive
from sim_backend.generator.kinds import SettingCommand
from sim_backend.generator.machine import Machine
from sim_backend.generator.models import MODELS, Model
from sim_backend.generator.scpi_text import (
    ScpiError,
    boolean,
    keyword,
    not_simulated,
    only_argument,
    refuse_arguments,
    whole_number,
)
from sim_backend.generator.stored_states import LOCATIONS, location_of

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


def _register(name: str, largest: int) -> Action:
    """Return the command that sets, or queries, the enable mask of status register ``name``, from 0 to ``largest``."""
    return Action(
        lambda instrument, arguments: instrument.status.enable(
            name, whole_number(only_argument(arguments), 0, largest)
        ),
        lambda instrument, arguments: instrument.status.enabled(name),
        f"0 to {largest}",
    )


def _wait_and_answer(instrument: Machine, arguments: tuple[str, ...]) -> str:
    """Wait until the burst of a command has ended, and reply "1" (*OPC?)."""
    instrument.wait()
    return "1"


def _beep(instrument: Machine, arguments: tuple[str, ...]) -> None:
    """Do nothing: the beeper is not simulated."""


def _order(instrument: Machine, arguments: tuple[str, ...]) -> None:
    instrument.byte_order = keyword(only_argument(arguments), ("NORMal", "SWAPped"))


def _power_on_recall(instrument: Machine, arguments: tuple[str, ...]) -> None:
    instrument.states.recalled_at_power_on = boolean(only_argument(arguments))


def _clear_at_power_on(instrument: Machine, arguments: tuple[str, ...]) -> None:
    instrument.status.cleared_at_power_on = boolean(only_argument(arguments))


def _always_on(instrument: Machine, arguments: tuple[str, ...]) -> None:
    """Accept ON; raise ``ScpiError`` for OFF: a trigger system that is not continuously armed is not simulated."""
    if not boolean(only_argument(arguments)):
        raise not_simulated("a trigger system that is not continuously armed")


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
    "*ESE": _register("ESE", 255),
    "*SRE": _register("SRE", 255),
    "*PSC": Action(
        _clear_at_power_on, lambda instrument, arguments: str(int(instrument.status.cleared_at_power_on)), "0, 1"
    ),
    "*SAV": Action(lambda instrument, arguments: instrument.save(location_of(arguments)), accepts="0 to 4"),
    "*RCL": Action(lambda instrument, arguments: instrument.recall(location_of(arguments)), accepts="0 to 4"),
    "*LRN": Action(query=lambda instrument, arguments: instrument.learn_string()),
}

SYSTEM: Mapping[str, Action] = {
    "SYSTem:ERRor[:NEXT]": Action(query=lambda instrument, arguments: instrument.status.next_error()),
    "SYSTem:VERSion": Action(query=_fixed(SCPI_VERSION)),
    "SYSTem:BEEPer[:IMMediate]": Action(_beep),
    "SYSTem:LOCal": Action(lambda instrument, arguments: instrument.set_local(True)),
    "SYSTem:REMote": Action(lambda instrument, arguments: instrument.set_local(False)),
    "SYSTem:RWLock": Action(lambda instrument, arguments: instrument.set_local(False)),
    "STATus:QUEStionable:CONDition": Action(query=lambda instrument, arguments: instrument.status.questionable()),
    "STATus:QUEStionable[:EVENt]": Action(query=_fixed("+0")),
    "STATus:QUEStionable:ENABle": _register("QUES", 32767),
    "STATus:PRESet": Action(lambda instrument, arguments: instrument.status.enable("QUES", 0)),
    "CALibration:COUNt": Action(query=_fixed("+0")),
    "CALibration:STRing": Action(query=_fixed('""')),
    "CALibration:SECure:STATe": Action(query=_fixed("1")),
    "MEMory:NSTates": Action(query=_fixed(f"{LOCATIONS:+d}")),
    "MEMory:STATe:NAME": Action(
        lambda instrument, arguments: instrument.states.rename(arguments),
        lambda instrument, arguments: f'"{instrument.states.name(location_of(arguments))}"',
        "0 to 4, name",
        "0 to 4",
    ),
    "MEMory:STATe:DELete": Action(
        lambda instrument, arguments: instrument.states.delete(location_of(arguments)), accepts="0 to 4"
    ),
    "MEMory:STATe:VALid": Action(
        query=lambda instrument, arguments: str(int(instrument.states.valid(location_of(arguments)))),
        query_accepts="0 to 4",
    ),
    "MEMory:STATe:RECall:AUTO": Action(
        _power_on_recall, lambda instrument, arguments: str(int(instrument.states.recalled_at_power_on)), "ON, OFF"
    ),
    "TRIGger<n>[:SEQuence][:IMMediate]": Action(lambda instrument, arguments: instrument.trigger()),
}


def _names(names: tuple[str, ...]) -> str:
    return ",".join(f'"{name}"' for name in names) or '""'


def _active(instrument: Machine) -> str:
    return str(instrument.registers.inactive.get("waveform", BUILT_IN[0]))


def _select(instrument: Machine, arguments: tuple[str, ...]) -> None:
    """Select the arbitrary waveform named in ``arguments``."""
    name = instrument.waveforms.select(only_argument(arguments))
    instrument.program(with_inactive(instrument.registers, waveform=name))


def _attribute(attribute: str) -> Action:
    """Return the query of an attribute of a waveform: of the one named in its argument, else of the active one."""

    def answer(instrument: Machine, arguments: tuple[str, ...]) -> str:
        """Return the reply to the query."""
        name = waveform_name(only_argument(arguments)) if arguments else _active(instrument)
        return instrument.waveforms.attribute(attribute, name)

    return Action(query=answer, query_accepts="name of a waveform, or none")


def _download(scale: float) -> Action:
    """Return the command that stores points in volatile memory, as numbers from minus ``scale`` to ``scale``."""
    accepts = f"VOLATILE, 1 to {MAX_POINTS} numbers of -{scale:g} to {scale:g}"
    return Action(lambda instrument, arguments: instrument.waveforms.download(arguments, scale), accepts=accepts)


def _download_named(scale: float) -> Action:
    """Return the command that stores points under a name, as numbers from minus ``scale`` to ``scale``."""
    accepts = f"name, {MIN_POINTS} to {MAX_POINTS} numbers of -{scale:g} to {scale:g}"
    return Action(lambda instrument, arguments: instrument.waveforms.download_named(arguments, scale), accepts=accepts)


WAVEFORMS: Mapping[str, Action] = {
    "FORMat:BORDer": Action(_order, lambda instrument, arguments: instrument.byte_order, "NORMal, SWAPped"),
    "[SOURce:]FUNCtion[:SHAPe]:USER": Action(
        _select, lambda instrument, arguments: _active(instrument), "name of a waveform"
    ),
    "DATA[:DATA]": _download(1.0),
    "DATA[:DATA]:DAC": _download(2047.0),
    "DATA:COPY": Action(lambda instrument, arguments: instrument.waveforms.copy(arguments), accepts="name, VOLATILE"),
    "DATA:CATalog": Action(query=lambda instrument, arguments: _names(instrument.waveforms.names)),
    "DATA:NVOLatile:CATalog": Action(query=lambda instrument, arguments: _names(instrument.waveforms.stored)),
    "DATA:NVOLatile:FREE": Action(query=lambda instrument, arguments: f"{SLOTS - len(instrument.waveforms.stored):+d}"),
    "DATA:DELete[:NAME]": Action(
        lambda instrument, arguments: instrument.waveforms.delete(
            waveform_name(only_argument(arguments)), _active(instrument)
        ),
        accepts="name of a waveform",
    ),
    "DATA:DELete:ALL": Action(lambda instrument, arguments: instrument.waveforms.delete_all(_active(instrument))),
    "DATA:ATTRibute:POINts": _attribute("POINTS"),
    "DATA:ATTRibute:AVERage": _attribute("AVERAGE"),
    "DATA:ATTRibute:CFACtor": _attribute("CFACTOR"),
    "DATA:ATTRibute:PTPeak": _attribute("PTPEAK"),
}
"""Commands for waveforms on the 33250A and the 33220A."""

OF_SERIES: Mapping[str, Action] = {
    "*OPT": Action(query=_fixed("0")),
    "[SOURce<n>:]PHASe:SYNChronize": Action(lambda instrument, arguments: None),
    "INITiate<n>:CONTinuous": Action(_always_on, _fixed("1"), "ON"),
    "[SOURce<n>:]FUNCtion:ARBitrary": Action(
        _select, lambda instrument, arguments: f'"{_active(instrument)}"', "name of a waveform"
    ),
    "[SOURce<n>:]DATA:ARBitrary": _download_named(1.0),
    "[SOURce<n>:]DATA:ARBitrary:DAC": _download_named(32767.0),
    "[SOURce<n>:]DATA:VOLatile:CLEar": Action(lambda instrument, arguments: instrument.waveforms.clear()),
    "[SOURce<n>:]DATA:VOLatile:CATalog": Action(
        query=lambda instrument, arguments: _names((*BUILT_IN, *instrument.waveforms.stored))
    ),
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

Entry = SettingCommand | Action
ALLOWED_IN_LOCAL = (SYSTEM["SYSTem:REMote"], SYSTEM["SYSTem:RWLock"], *ON_LAN.values())
"""Commands that an instrument on RS-232 accepts in local mode."""


def tree_of(model: Model) -> Mapping[str, Entry]:
    """Return all commands of ``model``, by the form of their header such as ``[SOURce<n>:]FREQuency[:CW]``."""
    # Models with numbered channels are those of the 33500 and 33600 series; the 33250A alone has no network.
    waveforms = OF_SERIES if model.channels else WAVEFORMS
    network = {} if model.name == "33250A" else ON_LAN
    return {**COMMON, **apply_forms(model.functions), **settings_of(model), **SYSTEM, **waveforms, **network}


@cache
def table_of(name: str) -> HeaderTable[Entry]:
    """Return the commands of a model by the name in its identity."""
    model = next(model for model in MODELS.values() if model.name == name)
    return HeaderTable(tree_of(model), model.channels)
