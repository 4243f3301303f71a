"""Commissioning of simulated benches whose cables and addresses differ from the bench file."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.interfaces import InstrumentError
from hpe_rig.bench import GENERATOR_ROLES, Bench, BenchFile, BenchText, parse_bench, read_bench
from hpe_rig.measurement import CableResult, Operator, Tap, commission, record_commissioning, taps, twin_operator
from hpe_rig.measurement.cable_signals import capture_of
from hpe_rig.measurement.commissioning import _records
from hpe_rig.scene import SettingsError
from sim_backend.settings import SimulationSettings
from sim_backend.world import Silence, World

PROBE_S = 7e-9
FIRES = 8
SHIPPED = read_bench().bench
ENDS = [(cable.source, cable.target) for cable in SHIPPED.wiring]


@dataclass
class Plug:
    """What is really plugged in at the end of a cable of the bench file: a cable from ``source``, None if nothing."""

    source: str | None
    delay_s: float
    inverted: bool = False


@dataclass
class ActualBench:
    """The bench as it is: by cable of the bench file the plug at its end, and by role the box at its address."""

    plugs: list[Plug]
    boxes: dict[str, str] = field(default_factory=dict)

    def world(self) -> World:
        wiring = [
            (plug.source, target, plug.delay_s, plug.inverted)
            for plug, (_, target) in zip(self.plugs, ENDS, strict=True)
            if plug.source is not None
        ]
        models = dict.fromkeys(GENERATOR_ROLES, "33250A")
        return World(SimulationSettings(), wiring, Silence(), models, boxes=self.boxes)

    def operator(self, instruments: Bench, tap: Tap | None) -> None:
        """Put the T piece where it belongs, with every output off."""
        world = instruments.world
        assert world is not None
        assert not any(world.outputs_on().values())
        plug = Plug(None, 0.0) if tap is None else Plug(tap.source, 0.0)
        if tap is not None and tap.target is not None:
            plug = self.plugs[ENDS.index((tap.source, tap.target))]
        cable = (plug.source or "", "digitizer.channel_b", plug.delay_s + PROBE_S, plug.inverted)
        world.plug([] if plug.source is None else [cable])

    @property
    def is_faulty(self) -> bool:
        as_stated = all(
            plug.source == source and not plug.inverted for plug, (source, _) in zip(self.plugs, ENDS, strict=True)
        )
        return not as_stated or any(role != box for role, box in self.boxes.items())

    def commissioned(self, rng: np.random.Generator, bench: BenchFile = SHIPPED) -> tuple[CableResult, ...]:
        return commission(bench, self.operator, rng, FIRES, self.world())


def permute_addresses(actual: ActualBench, rng: np.random.Generator) -> None:
    actual.boxes = dict(zip(GENERATOR_ROLES, rng.permutation(GENERATOR_ROLES).tolist(), strict=True))


def swap_cables(actual: ActualBench, rng: np.random.Generator) -> None:
    first, second = rng.choice(len(ENDS), 2, replace=False)
    plugs = actual.plugs
    plugs[first], plugs[second] = plugs[second], plugs[first]
    try:
        actual.world()
    except ValueError:
        # A loop of triggers never starts, as every input has one source: the same as two open cables.
        plugs[first], plugs[second] = Plug(None, 0.0), Plug(None, 0.0)


def open_cable(actual: ActualBench, rng: np.random.Generator) -> None:
    actual.plugs[rng.integers(len(ENDS))].source = None


def reverse_cable(actual: ActualBench, rng: np.random.Generator) -> None:
    plug = actual.plugs[rng.integers(len(ENDS))]
    plug.inverted = not plug.inverted


FAULTS: Sequence[Callable[[ActualBench, np.random.Generator], None]] = (
    permute_addresses,
    swap_cables,
    open_cable,
    reverse_cable,
)


def as_stated() -> ActualBench:
    return ActualBench([Plug(source, 10e-9 * (index + 1)) for index, (source, _) in enumerate(ENDS)])


def drawn(rng: np.random.Generator) -> ActualBench:
    """Return a bench with drawn delays and with 0, 1 or 2 faults."""
    actual = ActualBench([Plug(source, float(rng.uniform(0.0, 300e-9))) for source, _ in ENDS])
    for fault in rng.choice(len(FAULTS), rng.choice(3, p=[0.3, 0.5, 0.2])):
        FAULTS[fault](actual, rng)
    return actual


def commission_drawn_benches(seeds: range) -> None:
    """Assert that faults alone are found, and that 95 % of the delays are within 2 u."""
    within, good, accepted = [], [], []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        actual = drawn(rng)
        try:
            results = actual.commissioned(rng)
        except InstrumentError:
            refused = True
        else:
            refused = any(result.fault for result in results)
        good.append(refused == actual.is_faulty)
        accepted += [seed] if actual.is_faulty and not refused else []
        if not refused and not actual.is_faulty:
            within += [
                abs(result.delay_s - plug.delay_s) < 2 * result.delay_u_s
                for result, plug in zip(results, actual.plugs, strict=True)
            ]
    assert accepted == []
    assert [seed for seed, is_good in zip(seeds, good, strict=True) if not is_good] == []
    # Three standard deviations of the fraction of that many delays.
    assert np.mean(within) > 0.95 - 3 * np.sqrt(0.95 * 0.05 / len(within))


def test_every_fault_of_a_drawn_bench_is_found_and_delays_are_within_u() -> None:
    commission_drawn_benches(range(3))


@pytest.mark.slow
@pytest.mark.parametrize("block", range(10))
def test_every_fault_of_a_thousand_drawn_benches_is_found(block: int) -> None:
    commission_drawn_benches(range(1000 + 100 * block, 1100 + 100 * block))


def with_plug(index: int, **changes: object) -> ActualBench:
    actual = as_stated()
    actual.plugs[index] = replace(actual.plugs[index], **changes)
    return actual


def faults_of(results: Sequence[CableResult]) -> Mapping[tuple[str, str], str]:
    return {(result.source, result.target): result.fault for result in results if result.fault}


@pytest.mark.parametrize(
    ("actual", "cable", "words"),
    [
        (with_plug(0, source=None), 0, "The cable is open"),
        (with_plug(2, inverted=True), 2, "arrives inverted at toneburst.trigger"),
        pytest.param(with_plug(5, inverted=True), 5, "arrives inverted at transducer.drive", marks=pytest.mark.slow),
        pytest.param(
            with_plug(5, source="tracking_pulser.output"),
            5,
            "the signal of tracking_pulser arrives at transducer.drive",
            marks=pytest.mark.slow,
        ),
        pytest.param(with_plug(1, inverted=True), 1, "no pulse of the master arrives", marks=pytest.mark.slow),
        pytest.param(with_plug(3, inverted=True), 3, "the pulses arrive inverted", marks=pytest.mark.slow),
        pytest.param(
            with_plug(3, source="burst_train.output"), 3, "the pulses of burst_train arrive", marks=pytest.mark.slow
        ),
        pytest.param(with_plug(3, source=None), 3, "no pulse arrives", marks=pytest.mark.slow),
        pytest.param(with_plug(4, source=None), 4, "no signal at tracking_pulser.trigger", marks=pytest.mark.slow),
        (
            ActualBench(as_stated().plugs, {"toneburst": "tracking_pulser", "tracking_pulser": "toneburst"}),
            5,
            "at toneburst.output is the signal of tracking_pulser",
        ),
    ],
)
def test_a_fault_is_named_at_its_cable(actual: ActualBench, cable: int, words: str) -> None:
    fault = faults_of(actual.commissioned(np.random.default_rng(1)))[ENDS[cable]]
    assert words in fault
    assert "Try: " in fault


def test_faults_of_independent_cables_are_all_found() -> None:
    actual = as_stated()
    actual.plugs[5].inverted, actual.plugs[4].source = True, None
    faults = faults_of(actual.commissioned(np.random.default_rng(1)))
    # The pulser's cable cannot be tested without its trigger.
    assert set(faults) == {ENDS[4], ENDS[5], ENDS[6]}
    assert "the faults before this one" in faults[ENDS[6]]


def wrong_operators(actual: ActualBench) -> Mapping[str, Operator]:
    def never_moves(instruments: Bench, tap: Tap | None) -> None:
        actual.operator(instruments, tap and Tap("master.output"))

    def exchanges_both_ends(instruments: Bench, tap: Tap | None) -> None:
        ends = {Tap(*ENDS[6]): Tap(ENDS[6][0]), Tap(ENDS[6][0]): Tap(*ENDS[6])}
        actual.operator(instruments, tap and ends.get(tap, tap))

    def leads_to_channel_a(instruments: Bench, tap: Tap | None) -> None:
        assert instruments.world is not None
        instruments.world.plug([(tap.source, "digitizer.channel_a", PROBE_S)] if tap else [])

    return {
        "at burst_train.output is the signal of master": never_moves,
        "before it starts": exchanges_both_ends,
        "channel A": leads_to_channel_a,
    }


@pytest.mark.parametrize(
    "words",
    [
        "at burst_train.output is the signal of master",
        pytest.param("before it starts", marks=pytest.mark.slow),
        "channel A",
    ],
)
def test_mistakes_with_the_t_piece_are_found(words: str) -> None:
    actual, rng = as_stated(), np.random.default_rng(1)
    try:
        results = commission(SHIPPED, wrong_operators(actual)[words], rng, FIRES, actual.world())
        text = " ".join(result.fault for result in results)
    except InstrumentError as error:
        text = str(error)
    assert words in text


def test_records_are_awaited_after_the_last_trigger() -> None:
    """The twin's records are complete at once, those of a board are not."""
    deadlines_s: list[float] = []
    digitizer = SimpleNamespace(
        configure=lambda capture: None,
        arm=lambda: None,
        records=lambda deadline_s: deadlines_s.append(deadline_s) or (),
    )
    master = SimpleNamespace(enable_output=lambda: None, fire=lambda: None)
    clock = SimpleNamespace(now_s=lambda: 5.0, sleep=lambda duration_s: None)
    instruments: Any = SimpleNamespace(digitizer=digitizer, clock=clock, make_safe=lambda: None)
    _records(instruments, capture_of("master", SHIPPED, 1), master, (), None)  # type: ignore[arg-type]
    assert deadlines_s[0] - 5.0 > 0.1


def test_neighbouring_places_of_the_t_piece_have_different_signals() -> None:
    places = taps(SHIPPED)
    assert len(places) == len(set(places)) == 13
    assert all(first.source != second.source for first, second in itertools.pairwise(places))


def edited(*edits: tuple[str, str]) -> BenchFile:
    text = read_bench().text
    for old, new in edits:
        assert old in text, old
        text = text.replace(old, new)
    return parse_bench("edited", text).bench


@pytest.mark.parametrize(
    "bench",
    [
        pytest.param(edited(("dual_port_memory = true", "dual_port_memory = false")), marks=pytest.mark.slow),
        edited(("dual_port_memory = true", 'dual_port_memory = true\nacquisition_mode = "npt"')),
        pytest.param(edited(('model = "ATS460"', 'model = "ATS9870"')), marks=pytest.mark.slow),
        pytest.param(edited(('model = "33250A"', 'model = "33600A"')), marks=pytest.mark.slow),
        edited(("simulated = true", 'simulated = true\ntransport = "socket"')),
        pytest.param(
            edited(("load_ohm = 50.0\namplitude_vpp = 1.0", "load_ohm = inf\namplitude_vpp = 1.0\nmax_vpp = 1.5")),
            marks=pytest.mark.slow,
        ),
    ],
    ids=["single port", "npt", "8 bit", "33600A", "socket", "high impedance"],
)
def test_other_instruments_are_commissioned_as_well(bench: BenchFile) -> None:
    results = commission(bench, twin_operator(bench), np.random.default_rng(1), FIRES)
    assert not faults_of(results)
    for result in results:
        assert abs(result.delay_s - bench.path_delay_s(result.source, result.target)) < 3 * result.delay_u_s


def results_with(fault: str = "") -> list[CableResult]:
    good = [CableResult(*ends, 1e-9 * (index + 1), 0.4e-9) for index, ends in enumerate(ENDS)]
    return [replace(good[0], fault=fault), *good[1:]]


def written(path: Path, results: Sequence[CableResult]) -> BenchText:
    record_commissioning(path, read_bench(path), results, date(2026, 11, 25))
    return read_bench(path)


def test_delays_and_proofs_are_written_between_the_comments_of_the_bench_file(tmp_path: Path) -> None:
    path = tmp_path / "bench.toml"
    path.write_text(read_bench().text.replace("delay_s = 10e-9", "delay_s = 10e-9   # 2 m"), encoding="utf-8")
    after = written(path, results_with())
    assert [cable.delay_s for cable in after.bench.wiring] == pytest.approx([1e-9 * n for n in range(1, 8)])
    assert {cable.delay_u_s for cable in after.bench.wiring} == {0.4e-9}
    record = after.bench.commissioning
    assert record is not None
    assert (record.date, record.digest) == (date(2026, 11, 25), after.bench.commissioned_digest)
    assert record.cables[0] == "master.output -> burst_train.trigger"
    assert after.text.count("# 2 m") == 2
    assert "# feeds two TTL inputs" in after.text
    # A second commissioning replaces the first one.
    assert written(path, results_with()).text == after.text


def test_cables_on_one_line_each_are_completed_as_well(tmp_path: Path) -> None:
    text = read_bench().text
    head = text[: text.index("[[wiring]]")]
    lines = "\n".join(f'    {{ source = "{source}", target = "{target}" }},  # blue' for source, target in ENDS)
    path = tmp_path / "bench.toml"
    first_table = head.index("[limits]")
    path.write_text(f"{head[:first_table]}wiring = [\n{lines}\n]\n\n{head[first_table:]}", encoding="utf-8")
    after = written(path, results_with())
    assert [cable.delay_s for cable in after.bench.wiring] == pytest.approx([1e-9 * n for n in range(1, 8)])
    assert after.bench.commissioning is not None
    assert after.text.count("# blue") == 7


def test_a_commissioning_with_a_fault_withdraws_the_one_before(tmp_path: Path) -> None:
    path = tmp_path / "bench.toml"
    path.write_text(read_bench().text, encoding="utf-8")
    written(path, results_with())
    after = written(path, results_with("open"))
    assert after.bench.commissioning is None
    assert [cable.delay_s for cable in after.bench.wiring] == pytest.approx([1e-9 * n for n in range(1, 8)])


def test_a_bench_file_that_was_changed_meanwhile_keeps_its_changes_or_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "bench.toml"
    before = read_bench()
    path.write_text(before.text.replace("max_duty = 0.05", "max_duty = 0.04"), encoding="utf-8")
    record_commissioning(path, before, results_with(), date(2026, 11, 25))
    assert read_bench(path).bench.limits.max_duty == 0.04
    path.write_text(before.text.replace('model = "33250A"', 'model = "33600A"'), encoding="utf-8")
    with pytest.raises(SettingsError, match="were changed during the commissioning"):
        record_commissioning(path, before, results_with(), date(2026, 11, 25))
