"""The command tree: every form in every spelling, an example of each, APPLy, the second channel."""

from __future__ import annotations

import contextlib
import itertools
import math
import re
import runpy
import tracemalloc
from pathlib import Path

import pytest
from hypothesis import given, settings, strategies as st

from sim_backend.generator.command_tree import tree_of
from sim_backend.generator.instrument import Generator33250A
from sim_backend.generator.kinds import SettingCommand
from sim_backend.generator.models import MODELS
from sim_backend.wiring import PS_PER_S, SimulatedClock, no_steps

EXAMPLES = runpy.run_path(str(Path(__file__).with_name("command_examples.py")))["EXAMPLES"]
NO_ERROR = '+0,"No error"'
FORMS = [(name, form) for name, model in MODELS.items() for form in tree_of(model)]
FIRST = {form: name for name, form in reversed(FORMS)}
EVERY_FORM = [pytest.param(name, form, marks=() if FIRST[form] == name else pytest.mark.slow) for name, form in FORMS]
"""Every form by the first model that has it; by the other models it is marked slow."""
NODE = re.compile(r"(\[?):?([A-Za-z]+)(<n>)?:?\]?")


def real(value: float) -> str:
    """Return a number as the instrument prints it."""
    return f"{value:+.13E}"


def twin(name: str = "33250A") -> Generator33250A:
    return Generator33250A(SimulatedClock(), 0.0, MODELS[name])


def ask(generator: Generator33250A, message: str) -> str:
    generator.write(message)
    return generator.read()


def errors(generator: Generator33250A) -> list[int]:
    numbers = []
    while (reply := ask(generator, "SYST:ERR?")) != NO_ERROR:
        numbers.append(int(reply.split(",")[0]))
    return numbers


def spellings(form: str) -> list[str]:
    """Return a form in full, in short, in small letters, and with and without each optional node."""
    if form.startswith("*"):
        return [form, form.lower()]
    long = [(bool(bracket), node) for bracket, node, _ in NODE.findall(form)]
    short = [(optional, "".join(letter for letter in node if not letter.islower())) for optional, node in long]
    selections = list(itertools.product(*((True, False) if optional else (True,) for optional, _ in long)))
    spellings = [
        ":".join(node for keep, (_, node) in zip(mask, of, strict=True) if keep)
        for of in (long, short)
        for mask in selections
    ]
    return [
        *dict.fromkeys(
            [*spellings, *(spelling.lower() for spelling in spellings), *(f":{spelling}" for spelling in spellings)]
        )
    ]


def test_every_form_has_an_example_and_every_example_a_form() -> None:
    assert {form for _, form in FORMS} == set(EXAMPLES)


@pytest.mark.parametrize(("name", "form"), EVERY_FORM, ids=lambda value: value)
def test_the_example_of_every_command_holds_on_every_model(name: str, form: str) -> None:
    generator, example = twin(name), EXAMPLES[form]
    for message in example.message.splitlines():
        generator.write(message)
    if example.query == "*IDN?":
        assert ask(generator, "*IDN?") == MODELS[name].identity
    elif example.query and example.reply:
        assert ask(generator, example.query) == example.reply
    elif example.query:
        assert ask(generator, example.query)
    assert (errors(generator) or [0])[0] == (0 if "NONSENSE" in example.message else example.error)


@pytest.mark.parametrize(("name", "form"), EVERY_FORM, ids=lambda value: value)
def test_every_spelling_of_a_form_has_the_same_effect(name: str, form: str) -> None:
    entry = tree_of(MODELS[name])[form]
    queried = isinstance(entry, SettingCommand) and entry.query is not None
    replies = set()
    for spelling in spellings(form):
        generator = twin(name)
        generator.write(f"{spelling}?" if queried else spelling)
        replies.add(generator.read() if queried else ask(generator, "SYST:ERR?"))
    assert len(replies) == 1
    assert '-113,"Undefined header"' not in replies or entry.command is None


@pytest.mark.parametrize(("name", "form"), EVERY_FORM, ids=lambda value: value)
def test_sending_a_settings_reply_back_changes_nothing(name: str, form: str) -> None:
    entry = tree_of(MODELS[name])[form]
    if not isinstance(entry, SettingCommand) or None in (entry.query, entry.command):
        return
    generator, header = twin(name), spellings(form)[-1]
    generator.write(EXAMPLES[form].message)
    generator.write("*CLS")
    reply = ask(generator, f"{header}?")
    generator.write(f"{header} {reply}")
    assert (ask(generator, f"{header}?"), errors(generator)) == (reply, [])


def is_number(name: str, form: str) -> bool:
    entry = tree_of(MODELS[name])[form]
    return isinstance(entry, SettingCommand) and entry.query is not None and "MIN" in entry.accepts


NUMBERS = [each for each in EVERY_FORM if is_number(*each.values)]


@pytest.mark.parametrize(("name", "form"), NUMBERS, ids=lambda value: value)
def test_a_number_takes_its_limits_and_its_default_by_name(name: str, form: str) -> None:
    header = spellings(form)[-1]
    generator = twin(name)
    generator.write("TRIG:SOUR BUS")
    default, low, high = (float(ask(generator, f"{header}? {word}".strip())) for word in ("", "MIN", "MAX"))
    assert low <= default <= high
    for word in ("MIN", "MAXimum"):
        limit = float(ask(generator, f"{header}? {word}"))
        generator.write(f"{header} {word}")
        assert float(ask(generator, f"{header}?")) == pytest.approx(limit, rel=1e-12, abs=1e-15)
    generator.write(f"{header} DEF")
    assert float(ask(generator, f"{header}?")) == pytest.approx(default, rel=1e-12, abs=1e-15)


def test_the_missing_form_of_a_command_is_undefined() -> None:
    generator = twin()
    for message in ("*RST?", "*IDN", "SYST:ERR", "APPL", "APPL:SIN?", "PHAS:REF?", "TRIG?"):
        generator.write(message)
        assert errors(generator) == [-113], message


# APPLy


def test_apply_switches_the_output_on_at_once() -> None:
    generator = twin()
    generator.write("TRIG:SOUR EXT;:BURS:NCYC 3;STAT 1;:APPL:SIN 1.5E6,0.4")
    assert ask(generator, "OUTP?;:BURS:STAT?;:TRIG:SOUR?") == "1;0;IMM"
    bursts = generator.emission(no_steps(), PS_PER_S).bursts
    assert (bursts.carrier_hz.tolist(), int(bursts.end_ps[0])) == ([1.5e6], PS_PER_S)
    assert bursts.amplitude_vpp.tolist() == pytest.approx([0.8])


def test_apply_keeps_omitted_settings_and_clips_the_others() -> None:
    generator = twin()
    generator.write("FREQ 2E3;:VOLT 2;:VOLT:OFFS 0.5;:APPL:SQU")
    assert ask(generator, "APPL?") == f'"SQU {real(2e3)},{real(2)},{real(0.5)}"'
    generator.write("APPL:RAMP 30 MHZ, 1, 0")
    assert (float(ask(generator, "FREQ?")), errors(generator)) == (1e6, [-222])
    generator.write("APPL:SIN 1E3,8,2")
    assert errors(generator) == [-221]
    generator.write("APPL:SIN 1,2,3,4")
    assert errors(generator) == [-108]


def test_dc_is_a_level_at_the_output() -> None:
    generator = twin()
    generator.write("APPL:DC DEF,DEF,2")
    steps = generator.emission(no_steps(), PS_PER_S).steps
    assert (steps.before_v.tolist(), steps.after_v.tolist()) == ([0.0], [4.0])


# The second channel


@pytest.mark.parametrize("name", ["33500B", "33600A"])
def test_the_second_channel_has_separate_settings(name: str) -> None:
    generator = twin(name)
    generator.write("SOUR2:APPL:SIN 7E3,2;:OUTP2:LOAD 75;:TRIG2:SOUR BUS;:SOURce2:BURSt:NCYCles 9;STATe 1")
    assert ask(generator, "OUTP2?;:OUTP1?;:OUTP?") == "1;0;0"
    assert ask(generator, "SOUR2:FREQ?;:SOUR:FREQ?;:FREQ?") == ";".join(map(real, (7e3, 1e3, 1e3)))
    assert ask(generator, "SOUR2:BURS:STAT?;:SOUR1:BURS:STAT?;:TRIG2:SOUR?;:TRIG:SOUR?") == "1;0;BUS;IMM"
    generator.write("*RST")
    assert ask(generator, "OUTP2?;:SOUR2:BURS:NCYC?") == f"0;{real(1)}"
    assert errors(generator) == []


@pytest.mark.parametrize("header", ["SOUR3:FREQ?", "SOUR0:FREQ?", "OUTP12?", "SOUR99999999999999999999:FREQ?"])
def test_a_channel_that_does_not_exist_is_out_of_range(header: str) -> None:
    generator = twin("33500B")
    generator.write(header)
    assert errors(generator) == [-114]


def test_a_channel_number_is_accepted_at_marked_nodes_only() -> None:
    for name, header in (("33500B", "SOUR1:FREQ1?"), ("33250A", "SOUR1:FREQ?"), ("33500B", "SYST2:VERS?")):
        generator = twin(name)
        generator.write(header)
        assert errors(generator) == [-113]


# What the twin does not simulate


@pytest.mark.parametrize("name", MODELS)
def test_a_header_that_the_twin_does_not_simulate_says_so_and_other_headers_are_undefined(name: str) -> None:
    generator = twin(name)
    for message in (
        "AM:STAT ON",
        "sour:freq:star 5",
        "DATA:DAC VOLATILE, 1",
        "*RCL 1",
        "TRIG:TIM 2",
        "SOUR:SWE:STAT 1",
        "MARK:FREQ 5",
        "AM:X?",
    ):
        generator.write(f"OUTP 1;:{message}")
        assert "the twin does not simulate" in ask(generator, "SYST:ERR?")
        assert ask(generator, "OUTP?") == "1"
    for message in ("*SAX 1", "AMS ON", "FREQ:STAX 5", "BURS:STATE:GATE 1"):
        generator.write(message)
        assert errors(generator) == [-113]


def test_a_state_is_named_by_a_short_word_at_a_location_that_exists() -> None:
    generator = twin()
    for message in ("MEM:STAT:NAME 5,A", "MEM:STAT:NAME 1,A_NAME_THAT_IS_TOO_LONG", "MEM:STAT:NAME 1,2B"):
        generator.write(message)
    assert errors(generator) == [-222, -112, -148]
    generator.write("MEM:STAT:NAME 1,bench;*RST")
    assert ask(generator, "MEM:STAT:NAME? 1") == '"BENCH"'


# Invalid messages


@pytest.mark.parametrize(
    ("message", "number"),
    [
        ("OUTP 1E400", -222),
        ("VOLT 1e9 DBM", -222),
        ("VOLT -1e9 DBM", -222),
        ("VOLT 1E400", -222),
        ("FREQ -1E400", -222),
        ("BURS:NCYC -1E400", -222),
        ("OUTP:LOAD -1E400", -222),
        ("FREQ 1E99999", -123),
        ("FREQ 1E" + "9" * 5000, -123),
        ("FREQ " + "1" * 5000, -124),
        ("*ESE ²", -148),
        ("*ESE " + "1" * 5000, -124),
        ("*ESE 256", -222),
        ("*ESE 1.5E400", -222),
        ("OUTP ²", -224),
        ("FREQ² 5", -101),
        ("FREQ:²", -101),
        ("FREQ::CW 5", -102),
        (":", -102),
        ("*", -102),
        ("?", -102),
        ("A" * 5000, -112),
        ("FREQUENCYTOOLONG 5", -112),
        ("FREQ " + "1," * 200_000, -223),
        ("DISP:TEXT '" + "x" * 5000, -151),
        ("*IDN?;" * 50_000, 522),
        ('DISP:TEXT "a\' ;b"x', -151),
        ("\x00\xff", -101),
        ("FREQ \x00", -148),
    ],
    ids=lambda value: str(value)[:20],
)
def test_an_invalid_message_is_an_error_in_the_queue_of_every_model(message: str, number: int) -> None:
    generator = twin()
    generator.write(message)
    assert errors(generator) == [number]
    assert ask(generator, "OUTP?") == "0"


@pytest.mark.parametrize("settings", [5_000, pytest.param(200_000, marks=pytest.mark.slow)])
def test_settings_with_the_output_on_leave_the_memory_flat(settings: int) -> None:
    clock = SimulatedClock()
    generator = Generator33250A(clock, 0.0)
    generator.write("OUTP 1;:BURS:STAT 1;:TRIG:SOUR BUS")

    def program(count: int) -> None:
        for index in range(count):
            clock.sleep(1e-3)
            generator.write(f"FREQ {1000 + index % 7};:  FREQ:CW {1000 + index};*TRG")

    program(5_000)
    tracemalloc.start()
    program(settings)
    grown, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    # The history holds some thousand states of half a kilobyte, and the triggers.
    assert grown < 4e6


def test_the_page_of_commands_has_a_row_for_every_command() -> None:
    tool = Path(__file__).parents[3] / "docs" / "_build_tools" / "command_tree.py"
    page = runpy.run_path(str(tool))["page"]()
    rows = [line.split("`")[1] for line in page.splitlines() if line.startswith("| `")]
    assert sorted(rows) == sorted(set().union(*map(tree_of, MODELS.values())))


# Fuzzing: every header with every kind of argument

WORDS = """MIN MAX DEF INF ON OFF ONCE 0 1 -1 1E400 -1E400 1E-400 9.9E37 1E9DBM -1E9DBM 1KHZ 1MOHM 360DEG
'' "A" #14abcd SIN DC NOIS TRIG GAT EXT BUS VRMS DBM RAD RAMP PULS"""
# What a message can carry.
LATIN_1 = bytes(range(256)).decode("latin-1")
ARGUMENTS = st.one_of(st.sampled_from(["", *WORDS.split()]), st.floats().map(repr), st.text(LATIN_1, max_size=6))
MESSAGES = st.lists(st.tuples(st.integers(0, 10_000), st.booleans(), st.lists(ARGUMENTS, max_size=4)), max_size=12)


def fuzz(name: str, messages: list[tuple[int, bool, list[str]]]) -> None:
    """Send the messages, then see that the instrument is in its right mind."""
    generator, forms = twin(name), list(tree_of(MODELS[name]))
    for number, query, arguments in messages:
        spelled = spellings(forms[number % len(forms)])
        header = spelled[number % len(spelled)] + "?" * query
        generator.write(f"{header} {','.join(arguments)}")
        with contextlib.suppress(TimeoutError):
            assert generator.read()
    state = generator.registers
    assert state.high_v > state.low_v
    assert abs(state.high_v) <= 10.001
    assert abs(state.low_v) <= 10.001
    assert 0 < state.frequency_hz <= MODELS[name].frequency_limits_hz[state.function][1] * (1 + 1e-9)
    assert 0 < state.width_s < math.inf
    assert state.cycles >= 1
    errors(generator)
    assert ask(generator, "*OPC?") == "1"
    if state.frequency_hz < 1e6:
        generator.emission(no_steps(), PS_PER_S // 1000)


@settings(max_examples=6, deadline=None)
@given(st.sampled_from(list(MODELS)), MESSAGES)
def test_the_instrument_works_after_any_message(name: str, messages: list[tuple[int, bool, list[str]]]) -> None:
    fuzz(name, messages)


@pytest.mark.slow
@settings(max_examples=3_000, deadline=None)
@given(st.sampled_from(list(MODELS)), MESSAGES)
def test_the_instrument_works_after_any_message_long(name: str, messages: list[tuple[int, bool, list[str]]]) -> None:
    fuzz(name, messages)
