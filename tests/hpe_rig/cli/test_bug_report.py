"""A bug report holds what is needed to repeat a problem, and nothing that identifies a bench or a person."""

from __future__ import annotations

import getpass
import socket
import tomllib
from pathlib import Path

import pytest
from typer.testing import CliRunner

import hpe_rig as hpe
from hpe_rig.cli.app import app
from hpe_rig.cli.bug_report import anonymous


def report(*files: Path) -> str:
    target = files[0].with_name("report.txt")
    names = [str(file) for file in files]
    done = CliRunner().invoke(app, ["bug-report", *names, "-o", str(target)], catch_exceptions=False)
    assert done.exit_code == 0
    return target.read_text(encoding="utf-8")


def test_a_report_holds_versions_scene_bench_and_log(tmp_path: Path) -> None:
    run = tmp_path / "run.h5"
    assert CliRunner().invoke(app, ["run", "table-1", "--verbose", "--output", str(run)]).exit_code == 0
    damaged = tmp_path / "damaged.h5"
    damaged.write_bytes(b"no HDF5")
    text = report(run, damaged)
    for part in ("numpy", "pyvisa-py", "pulse_rate_hz", "max_duty", "status: complete", "run.log", "cannot be read"):
        assert part in text


@pytest.mark.parametrize(
    ("text", "secret"),
    [
        ('address = "TCPIP0::192.168.1.17::inst0::INSTR"', "192.168"),
        ("no answer at TCPIP0::scope-lab3.example.org::INSTR within 2 s", "lab3"),
        ("opened USB0::0x0957::0x0407::MY44001234::0::INSTR", "MY44001234"),
        ("ASRL/dev/ttyUSB0::INSTR answers", "ttyUSB0"),
        ("identity Agilent Technologies,33250A,MY44001234,1.05", "MY44001234"),
        ('interface = "PRLGX-TCPIP0::10.0.0.5::1234::INTFC"', "10.0.0.5"),
        ('serial = "label 7"', "label 7"),
        ('who = "A. Bee"', "Bee"),
        ('[calibration]\ndate = 2026-03-05\nsource = "A. Bee, tank"\n', "Bee"),
        ("write to a.bee@example.org", "a.bee"),
        ('[notes]\npatient = "X17"\n\n[tracking]', "X17"),
        (f"{Path.home()}/runs/run.h5", str(Path.home())),
        (f"started on {socket.gethostname()}", socket.gethostname()),
        (f"by {getpass.getuser()} today", getpass.getuser()),
    ],
)
def test_what_identifies_a_bench_or_a_person_is_removed(text: str, secret: str) -> None:
    assert secret in text
    assert secret not in anonymous(text)
    assert "REMOVED" in anonymous(text)


def test_numbers_and_keys_of_a_scene_stay() -> None:
    scene = '[tracking]\npulse_rate_hz = 3990.0\ncarrier_hz = 9.0e6\n[[wiring]]\nsource = "master.sync"\n'
    assert anonymous(scene) == scene


@pytest.mark.parametrize("name", ["echoes.csv", "absent.toml", "."])
def test_files_that_may_hold_echoes_or_are_absent_are_refused(name: str, tmp_path: Path) -> None:
    (tmp_path / "echoes.csv").write_text("1,2,3\n", encoding="utf-8")
    target = tmp_path / "report.txt"
    done = CliRunner().invoke(app, ["bug-report", str(tmp_path / name), "-o", str(target)])
    assert done.exit_code == 2
    assert not target.exists()


def test_an_existing_report_is_not_replaced(tmp_path: Path) -> None:
    target = tmp_path / "report.txt"
    target.write_text("mine", encoding="utf-8")
    done = CliRunner().invoke(app, ["bug-report", "-o", str(target)])
    assert done.exit_code != 0
    assert target.read_text(encoding="utf-8") == "mine"


def test_the_citation_file_names_the_version_and_the_papers_of_the_documentation() -> None:
    root = Path(hpe.__file__).parents[1]
    citation = (root / "CITATION.cff").read_text(encoding="utf-8").lower()
    page = " ".join((root / "docs/validation/index.md").read_text(encoding="utf-8").lower().split())
    titles = [line.partition("title: ")[2] for line in citation.splitlines() if line.startswith("    title: ")]
    assert len(titles) == 2
    assert all(title in page for title in titles)
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert f"version: {project['version']}\n" in citation
