"""Options that exclude each other are refused before anything is measured."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from hpe_rig.cli.app import app


@pytest.mark.parametrize("command", [["run", "table-1"], ["process", "run.h5"], ["list"]])
def test_two_formats_are_refused(command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, [*command, "--json", "--csv"])
    assert done.exit_code != 0
    assert "--json, --csv: both formats are requested" in done.output
    assert not list(tmp_path.iterdir())
