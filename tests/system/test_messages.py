"""Frequent mistakes of users get a message with cause and remedy, and no traceback."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]
ANSWERS = {
    "hpe-rig run bovine-muscel": "did you mean bovine-muscle?",
    "hpe-rig run s": "did you mean s.toml?",
    "hpe-rig chekc bovine-muscle": "Did you mean 'check'?",
    "hpe-rig run bovine-muscle --estimator kasia": "did you mean kasai?",
    'hpe-rig run bovine-muscle --output ""': "no file is named",
    "hpe-rig run s.toml --bench s.toml": "this is a scene, not a bench file",
    "hpe-rig check b.toml": "this is a bench file, not a scene",
    "hpe-rig live nofile.h5": "no run can be followed",
    "hpe-rig run bovine-muscle --output no-folder/run.h5": "the folder no-folder does not exist. Try: make it",
}
CAUSES = {
    "a key is given twice": "line 6, 'burst_count = 30': this key occurs twice",
    "a table is given twice": "line 9, '[tracking]': this table occurs twice",
    "saved as UTF-16, as Windows' Notepad can": "saved as UTF-16",
    "the file is empty": "it is empty",
    "a key is misspelt": "did you mean burst_count?",
    "a section is misspelt": "did you mean excitation?",
    "a unit is forgotten: microseconds": "burst_length_s = 100 s, where the shipped scenes have 50 us to 200 us. "
    "Try: perhaps 100e-6?",
    "a comma for a point": "line 7, 'pulse_rate_hz = 3990,0': a comma in a number",
    "a quotation mark is missing": "line 1, 'title = \"Try': a quotation mark is missing",
}


@pytest.fixture(scope="module")
def messages() -> ModuleType:
    spec = importlib.util.spec_from_file_location("messages", ROOT / "docs" / "_build_tools" / "messages.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["messages"] = module
    spec.loader.exec_module(module)
    return module


def test_messages_of_frequent_mistakes_have_cause_and_remedy(messages: ModuleType) -> None:
    answers = messages.provoked()
    assert len(answers) >= 40
    for _, case, code, message in answers:
        assert code == 2, f"{case.typed}: exit code {code}\n{message}"
        assert "Traceback" not in message
        assert "error of the program" not in message
        # A usage error of the command line says how to get help; all others give a remedy.
        assert any(word in message for word in ("Try", "did you mean")), f"{case.typed}: {message}"
        expected = CAUSES.get(case.cause) or ANSWERS.get(case.typed, "")
        # Only words are compared, because long lines are wrapped at the width of the terminal.
        assert " ".join(expected.split()) in " ".join(message.split()), f"{case.typed} ({case.cause}): {message}"
    assert set(CAUSES) <= {case.cause for _, case, _, _ in answers}
    assert set(ANSWERS) <= {case.typed for _, case, _, _ in answers}
