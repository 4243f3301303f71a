"""The main job as on metal: VISA addresses, a vendor's library compiled from C, the clock on the wall.

Behind the addresses are emulators, behind the library the simulated board, and they share one world: what the drivers
programmed over the wires is what the board is triggered by. The bench file says ``simulated = false``, and nothing in
the application knows better.
"""

from __future__ import annotations

import ctypes
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from drivers.alazar.api import SIGNATURES, load_library
from hpe_rig.bench import Bench, parse_bench, read_bench, twin_tables
from hpe_rig.bench.emulation import addressed
from hpe_rig.cli import commands, commission as command
from hpe_rig.measurement import Tap, commission
from hpe_rig.measurement.run import record_run
from hpe_rig.measurement.setup import prepare
from hpe_rig.runs.run import open_run, process
from sim_backend.settings import SimulationSettings
from sim_backend.transports import Emulator
from sim_backend.wiring import PS_PER_S
from sim_backend.world import World

SOURCE = Path(__file__).parents[1] / "drivers" / "alazar" / "compiled" / "ats_twin.c"
SIMULATED = read_bench().text
MILLISECOND_PS = PS_PER_S // 1000

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="the compiled library is built for POSIX systems")


@pytest.fixture(scope="module")
def library_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    configured = (os.environ.get("CC") or sysconfig.get_config_var("CC") or "cc").split()[0]
    found = shutil.which(configured) or shutil.which("cc") or shutil.which("gcc")
    assert found, "no C compiler: this test builds a stand-in for the vendor's library; install gcc, or set CC"
    path = tmp_path_factory.mktemp("twin") / "libATSApi.so"
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-O1", "-fPIC", "-shared"]
    subprocess.run([found, *flags, "-o", str(path), str(SOURCE)], check=True)
    return path


class Passing:
    """Lets the world's time pass as the wall's does, from one call of the library to the next.

    In whole milliseconds, each of a whole number of sample periods: when a trigger comes within one stays the same.
    """

    def __init__(self, world: World) -> None:
        self._world, self._then_s = world, time.monotonic()

    def __call__(self) -> None:
        passed = int((time.monotonic() - self._then_s) * 1e3)
        self._then_s += passed / 1e3
        self._world.clock.now_ps += passed * MILLISECOND_PS


def connect(path: Path, world: World) -> list[object]:
    """Have the compiled library carry out its functions on the board of ``world``; return what must stay alive."""
    compiled, board, passing = ctypes.CDLL(str(path)), world.alazar_library(), Passing(world)
    kept: list[object] = []
    for name, (result, arguments) in SIGNATURES.items():

        def carried_out(*values: object, name: str = name) -> object:
            passing()
            return getattr(board, name)(*values)

        function = ctypes.CFUNCTYPE(result, *arguments)(carried_out)
        assert compiled.TwinConnect(name.encode(), function) == 1
        kept.append(function)
    return kept


@contextmanager
def metal(folder: Path, library: Path, scene: str, *edits: tuple[str, str]) -> Iterator[Path]:
    """Yield a real bench's file, with all that it names alive: generators at VISA addresses, a board in the library."""
    with metal_and_world(folder, library, scene, *edits) as (path, _):
        yield path


@contextmanager
def metal_and_world(folder: Path, library: Path, scene: str, *edits: tuple[str, str]) -> Iterator[tuple[Path, World]]:
    """As ``metal``, with the world behind the wires."""
    text = SIMULATED
    for old, new in edits:
        assert old in text
        text = text.replace(old, new)
    bench = parse_bench("simulated", text).bench
    settings = SimulationSettings.model_validate(twin_tables(prepare(scene).scene.scene))
    wiring = [(cable.source, cable.target, cable.delay_s) for cable in bench.wiring]
    world = World(settings, wiring, models={"digitizer": bench.digitizer.model})
    with Emulator("socket", world.connect, tuple(bench.generators.by_role)) as emulator:
        places = {role: (there.address, there.interface) for role, there in emulator.served.items()}
        # An assumed calibration is none on a real bench.
        uncalibrated = re.sub(r"^\[calibration.*?(?=^\[generators)", "", text, flags=re.MULTILINE | re.DOTALL)
        spelled = addressed(parse_bench("simulated", uncalibrated), "socket", places)
        spelled = spelled.replace('transport = "socket"\n', "").replace("simulated = true", "simulated = false")
        for number, role in enumerate(bench.generators.by_role, 1):
            spelled = spelled.replace(f"[generators.{role}]", f'[generators.{role}]\nserial = "SIM_BOX_{number}"')
        spelled = spelled.replace("[digitizer]", f'[digitizer]\nlibrary = "{library}"')
        spelled = re.sub(r"^title = .*$", 'title = "Bench behind wires"', spelled, flags=re.MULTILINE)
        path = folder / "metal.toml"
        path.write_text(spelled, encoding="utf-8")
        kept = connect(library, world)
        yield path, world
        assert not any(world.outputs_on().values())
        assert not world.is_capturing()
        assert kept


@pytest.fixture(autouse=True)
def own_locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep this bench's lock to itself: every board here has the same number."""
    monkeypatch.setenv("HPE_RIG_LOCKS", str(tmp_path))


EDITS = {
    "shipped": (),
    "single port": (("dual_port_memory = true", 'dual_port_memory = true\nacquisition_mode = "single_port"'),),
    "npt": (("dual_port_memory = true", 'dual_port_memory = true\nacquisition_mode = "npt"'),),
    "ATS9440": (('model = "ATS460"', 'model = "ATS9440"'),),
    "ATS9870": (('model = "ATS460"', 'model = "ATS9870"'),),
}
FAST = {"npt"}
"""The other benches are marked slow."""


@pytest.mark.parametrize(
    "edits",
    [pytest.param(edits, id=name, marks=() if name in FAST else pytest.mark.slow) for name, edits in EDITS.items()],
)
def test_the_main_job_on_a_bench_behind_wires_gives_the_simulated_runs_numbers(
    tmp_path: Path, library_path: Path, edits: tuple[tuple[str, str], ...]
) -> None:
    simulated = tmp_path / "simulated.toml"
    text = SIMULATED
    for old, new in edits:
        text = text.replace(old, new)
    simulated.write_text(text, encoding="utf-8")
    # The clocks of the simulated bench are exact; those of the other bench are only as accurate as their models.
    exact = {"processing.frequency_accuracy": 0.0}
    direct = open_run(record_run(prepare("bovine-muscle", simulated, changes=exact), tmp_path / "direct.h5"))
    with metal(tmp_path, library_path, "bovine-muscle", *edits) as bench:
        wired = open_run(record_run(prepare("bovine-muscle", bench, changes=exact), tmp_path / "wired.h5"))
    assert (wired.stored.simulated, wired.stored.status) == (False, "complete")
    np.testing.assert_array_equal(wired.records[0].codes, direct.records[0].codes)
    spacing_s = [np.diff(run.records[0].trigger_time_s) for run in (wired, direct)]
    np.testing.assert_allclose(*spacing_s, rtol=0, atol=1e-12)
    pairs = zip(process(wired.path).shots[0].estimates, process(direct.path).shots[0].estimates, strict=True)
    for one, other in pairs:
        assert (one.frequency_hz, one.tracked_amplitude_m, one.tracked_phase_rad) == (
            other.frequency_hz,
            pytest.approx(other.tracked_amplitude_m, rel=1e-9),
            pytest.approx(other.tracked_phase_rad, abs=1e-9),
        )


def test_the_compiled_library_has_every_function_and_refuses_what_nobody_carries_out(library_path: Path) -> None:
    copy = library_path.with_name("unconnected.so")
    shutil.copy(library_path, copy)
    library = load_library(name=str(copy))
    assert library.AlazarGetBoardBySystemID(1, 1) is None
    assert library.AlazarStartCapture(1) == 572


@pytest.mark.parametrize("reversed_cable", [pytest.param(False, marks=pytest.mark.slow), True])
def test_the_bench_behind_wires_is_commissioned(tmp_path: Path, library_path: Path, reversed_cable: bool) -> None:
    """The person at the terminal is replaced; all else is as on metal."""
    with metal_and_world(tmp_path, library_path, "table-1") as (path, world):
        bench = read_bench(path).bench

        def move(instruments: Bench, tap: Tap | None) -> None:
            assert instruments.world is None
            assert not any(world.outputs_on().values())
            delay_s = bench.path_delay_s(tap.source, tap.target) if tap and tap.target else 0.0
            at_fault = reversed_cable and tap == Tap("toneburst.output", "transducer.drive")
            world.plug([(tap.source, "digitizer.channel_b", delay_s + 5e-9, at_fault)] if tap else [])

        results = commission(bench, move, np.random.default_rng(1), 8)
    faults = {result.source: result.fault for result in results if result.fault}
    assert list(faults) == ["toneburst.output"] * reversed_cable
    for result in results:
        if not result.fault:
            error_s = result.delay_s - bench.path_delay_s(result.source, result.target)
            assert abs(error_s) < 2.5 * result.delay_u_s


def test_ctrl_c_at_a_question_leaves_outputs_off_and_the_bench_file_as_it_was(
    tmp_path: Path, library_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    questions: list[str] = []

    def answer(question: str) -> str:
        questions.append(question)
        if len(questions) == 3:
            raise KeyboardInterrupt
        return "yes"

    monkeypatch.setattr(command, "has_terminal", lambda: True)
    monkeypatch.setattr(command, "answer", answer)
    with metal(tmp_path, library_path, "table-1") as path:
        before = path.read_text(encoding="utf-8")
        done = CliRunner().invoke(commands, ["commission", str(path)])
        assert done.exit_code == 130, done.output
        assert path.read_text(encoding="utf-8") == before
    assert "interrupted; every output is off, verified" in done.output
    assert "amplifier switched off?" in questions[0]
    assert questions[2].startswith("2 of 13: T piece at burst_train.output; ")
