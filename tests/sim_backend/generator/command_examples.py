"""Examples of every command: message, query, and the reply expected from the manual.

The page of the command tree (docs/_build_tools/command_tree.py) shows them with the forms.
"""

from __future__ import annotations

from typing import NamedTuple


class Example(NamedTuple):
    """A message, the query after it (empty for none) and the reply; ``error`` is the first number in the queue."""

    message: str
    query: str = ""
    reply: str = ""
    error: int = 0


def real(value: float) -> str:
    """Return a number as the instrument prints it."""
    return f"{value:+.13E}"


def refused(message: str, query: str = "", reply: str = "0") -> Example:
    return Example(message, query, reply if query else "", -241)


SOURCE = "[SOURce<n>:]"
VOLTAGE = f"{SOURCE}VOLTage[:LEVel][:IMMediate]"
TRIGGER = "TRIGger<n>[:SEQuence]"

COMMON = {
    "*IDN": Example("", "*IDN?", "Agilent Technologies,33250A,0,2.01-1.01-2.00-03-2"),
    "*RST": Example("FREQ 5E3;*RST", "FREQ?", real(1e3)),
    "*CLS": Example("NONSENSE\n*CLS", "*ESR?", "+0"),
    "*TRG": Example("TRIG:SOUR EXT;*TRG", error=-211),
    "*WAI": Example("*WAI", "*ESR?", "+128"),
    "*OPC": Example("*OPC", "*ESR?", "+129"),
    "*TST": Example("", "*TST?", "+0"),
    "*ESR": Example("", "*ESR?", "+128"),
    "*STB": Example("", "*STB?", "+0"),
    "*ESE": Example("*ESE 60", "*ESE?", "+60"),
    "*OPT": Example("", "*OPT?", "0"),
}
APPLIED = "FREQ?;VOLT?;VOLT:OFFS?;:OUTP?"
APPLY = {
    f"{SOURCE}APPLy": Example(
        "APPL:SIN 5E3,3,-2.5", "APPL?", '"SIN +5.0000000000000E+03,+3.0000000000000E+00,-2.5000000000000E+00"'
    ),
    f"{SOURCE}APPLy:SINusoid": Example("APPL:SIN 5 KHZ,3 VPP,-2.5 V", "FUNC?;:OUTP?", "SIN;1"),
    f"{SOURCE}APPLy:SQUare": Example("FUNC:SQU:DCYC 30;:APPL:SQU 5E3", "FUNC?;FUNC:SQU:DCYC?", f"SQU;{real(50)}"),
    f"{SOURCE}APPLy:RAMP": Example("FUNC:RAMP:SYMM 30;:APPL:RAMP", "FUNC?;FUNC:RAMP:SYMM?", f"RAMP;{real(100)}"),
    f"{SOURCE}APPLy:TRIangle": Example("APPL:TRI 1E3", "FUNC?;:OUTP?", "TRI;1"),
    f"{SOURCE}APPLy:PULSe": Example("APPL:PULS 1E3,4,DEF", "FUNC?;:OUTP?", "PULS;1"),
    f"{SOURCE}APPLy:NOISe": Example("APPL:NOIS DEF,2", f"FUNC?;{APPLIED[6:]}", f"NOIS;{real(2)};{real(0)};1"),
    f"{SOURCE}APPLy:DC": Example("APPL:DC DEF,DEF,-2.5", "FUNC?;VOLT:OFFS?;:OUTP?", f"DC;{real(-2.5)};1"),
    f"{SOURCE}APPLy:USER": refused("APPL:USER 1E3", "OUTP?"),
    f"{SOURCE}APPLy:PRBS": refused("APPL:PRBS 1E3", "OUTP?"),
    f"{SOURCE}APPLy:ARBitrary": refused("APPL:ARB 1E3", "OUTP?"),
}
WAVEFORM = {
    f"{SOURCE}FUNCtion[:SHAPe]": Example("FUNC SQUare", "FUNC?", "SQU"),
    f"{SOURCE}FUNCtion[:SHAPe]:SQUare:DCYCle": Example("FUNC:SQU:DCYC 30", "FUNC:SQU:DCYC?", real(30)),
    f"{SOURCE}FUNCtion[:SHAPe]:RAMP:SYMMetry": Example("FUNC:RAMP:SYMM 25", "FUNC:RAMP:SYMM?", real(25)),
    f"{SOURCE}FREQuency[:CW]": Example("FREQ 5 KHZ", "FREQ?", real(5e3)),
    VOLTAGE + "[:AMPLitude]": Example("VOLT 250 MVPP", "VOLT?", real(0.25)),
    VOLTAGE + ":OFFSet": Example("VOLT:OFFS -1.5", "VOLT:OFFS?", real(-1.5)),
    VOLTAGE + ":HIGH": Example("VOLT:HIGH 2", "VOLT:HIGH?", real(2)),
    VOLTAGE + ":LOW": Example("VOLT:LOW -2", "VOLT:LOW?", real(-2)),
    VOLTAGE + ":UNIT[:VOLTage]": Example("VOLT:UNIT VRMS", "VOLT:UNIT?", "VRMS"),
    f"{SOURCE}VOLTage:RANGe:AUTO": Example("VOLT:RANG:AUTO ONCE", "VOLT:RANG:AUTO?", "0"),
    "[SOURce:]PULSe:PERiod": Example("PULS:PER 200 US", "PULS:PER?", real(200e-6)),
    "[SOURce:]PULSe:WIDTh": Example("PULS:WIDT 10 US", "PULS:WIDT?", real(10e-6)),
    "[SOURce:]PULSe:TRANsition": Example("PULS:TRAN 8 NS", "PULS:TRAN?", real(8e-9)),
    "[SOURce:]FUNCtion:PULSe:TRANsition": Example("FUNC:PULS:TRAN 8 NS", "FUNC:PULS:TRAN?", real(8e-9)),
    f"{SOURCE}FUNCtion:PULSe:PERiod": Example("FUNC:PULS:PER 200 US", "FUNC:PULS:PER?", real(200e-6)),
    f"{SOURCE}FUNCtion:PULSe:WIDTh": Example("FUNC:PULS:WIDT 10 US", "FUNC:PULS:WIDT?", real(10e-6)),
    f"{SOURCE}FUNCtion:PULSe:TRANsition[:BOTH]": Example("FUNC:PULS:TRAN:BOTH 9 NS", "FUNC:PULS:TRAN?", real(9e-9)),
    f"{SOURCE}FUNCtion:PULSe:DCYCle": Example("FUNC:PULS:DCYC 25", "FUNC:PULS:WIDT?", real(250e-6)),
    f"{SOURCE}FUNCtion:PULSe:HOLD": Example("FUNC:PULS:HOLD DCYC;:FREQ 500", "FUNC:PULS:WIDT?", real(200e-6)),
    f"{SOURCE}PHASe[:ADJust]": Example("PHAS 90", "PHAS?", real(90)),
    f"{SOURCE}PHASe:REFerence": Example("PHAS 90;:PHAS:REF", "PHAS?", real(0)),
    f"{SOURCE}PHASe:SYNChronize": Example("PHAS:SYNC", "*ESR?", "+128"),
    "UNIT:ANGLe": Example("UNIT:ANGL RAD", "UNIT:ANGL?", "RAD"),
}
BURST_AND_TRIGGER = {
    f"{SOURCE}BURSt:STATe": Example("BURS:STAT ON", "BURS:STAT?", "1"),
    f"{SOURCE}BURSt:MODE": Example("BURS:MODE GATed", "BURS:MODE?", "GAT"),
    f"{SOURCE}BURSt:NCYCles": Example("TRIG:SOUR BUS;:BURS:NCYC INF", "BURS:NCYC?", real(9.9e37)),
    f"{SOURCE}BURSt:INTernal:PERiod": Example("BURS:INT:PER 20 MS", "BURS:INT:PER?", real(20e-3)),
    f"{SOURCE}BURSt:PHASe": Example("BURS:PHAS -90", "BURS:PHAS?", real(-90)),
    TRIGGER + ":SOURce": Example("TRIG:SOUR EXTernal", "TRIG:SOUR?", "EXT"),
    TRIGGER + ":SLOPe": Example("TRIG:SLOP NEG", "TRIG:SLOP?", "NEG"),
    TRIGGER + ":DELay": Example("TRIG:SOUR EXT;DEL 300 US", "TRIG:DEL?", real(300e-6)),
    TRIGGER + "[:IMMediate]": Example("TRIG", error=-211),
}
OUTPUT = {
    "OUTPut<n>[:STATe]": Example("OUTP ON", "OUTP:STAT?", "1"),
    "OUTPut<n>:LOAD": Example("OUTP:LOAD INF", "OUTP:LOAD?", real(9.9e37)),
    "OUTPut<n>:POLarity": Example("OUTP:POL INV", "OUTP:POL?", "INV"),
    "OUTPut:SYNC[:STATe]": Example("OUTP:SYNC OFF", "OUTP:SYNC?", "0"),
    "OUTPut:TRIGger[:STATe]": Example("OUTP:TRIG ON", "OUTP:TRIG?", "1"),
    "OUTPut:TRIGger:SLOPe": Example("OUTP:TRIG:SLOP NEG", "OUTP:TRIG:SLOP?", "NEG"),
}
SYSTEM = {
    "SYSTem:ERRor[:NEXT]": Example("NONSENSE", "SYST:ERR?", '-113,"Undefined header"'),
    "SYSTem:VERSion": Example("", "SYST:VERS?", "1999.0"),
    "SYSTem:BEEPer[:IMMediate]": Example("SYST:BEEP", "*ESR?", "+128"),
    "SYSTem:BEEPer:STATe": Example("SYST:BEEP:STAT OFF", "SYST:BEEP:STAT?", "0"),
    "SYSTem:LOCal": Example("SYST:LOC", error=514),
    "SYSTem:REMote": Example("SYST:REM", error=514),
    "SYSTem:RWLock": Example("SYST:RWL", error=514),
    "SYSTem:COMMunicate:RLSTate": Example("SYST:COMM:RLST REM", "*ESR?", "+128"),
    "DISPlay[:WINDow][:STATe]": Example("DISP OFF", "DISP?", "0"),
    "DISPlay[:WINDow]:TEXT[:DATA]": Example('DISP:TEXT "A;B"', "DISP:TEXT?", '"A;B"'),
    "DISPlay[:WINDow]:TEXT:CLEar": Example('DISP:TEXT "A";TEXT:CLE', "DISP:TEXT?", '""'),
    "STATus:QUEStionable:CONDition": Example("", "STAT:QUES:COND?", "+0"),
    "MEMory:STATe:NAME": Example("MEM:STAT:NAME 1,BENCH", "MEM:STAT:NAME? 1", '"BENCH"'),
}
OFF_ONLY = {
    f"{SOURCE}AM:STATe": Example("AM:STAT OFF", "AM:STAT?", "0"),
    f"{SOURCE}FM:STATe": Example("FM:STAT 0", "FM:STAT?", "0"),
    f"{SOURCE}FSKey:STATe": Example("FSK:STAT OFF", "FSK:STAT?", "0"),
    f"{SOURCE}SWEep:STATe": refused("SWE:STAT ON", "SWE:STAT?"),
    f"{SOURCE}MARKer[:STATe]": Example("MARK OFF", "MARK?", "0"),
}
GROUPS = {
    "Common commands": COMMON,
    "APPLy": APPLY,
    "Waveform and levels": WAVEFORM,
    "Bursts and triggers": BURST_AND_TRIGGER,
    "Output": OUTPUT,
    "Functions that are always off": OFF_ONLY,
    "Status, system, display, memory": SYSTEM,
}
EXAMPLES = {form: example for group in GROUPS.values() for form, example in group.items()}
