"""First mistakes get plain answers: what is wrong, where, and what to try; never a traceback, never silence."""

from __future__ import annotations

import importlib.util
import json
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
    "a key stands twice": "line 6, 'burst_count = 30': this key stands a second time",
    "a table stands twice": "line 9, '[tracking]': this table stands a second time",
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


def test_the_forty_mistakes_that_users_make_first_are_answered(messages: ModuleType) -> None:
    found = messages.answered()
    assert len(found) >= 40
    for _, case, code, said in found:
        assert code == 2, f"{case.typed}: exit code {code}\n{said}"
        assert "Traceback" not in said
        assert "error of the program" not in said
        # A usage error of the command line says how to get help; all others what to try.
        assert any(word in said for word in ("Try", "did you mean")), f"{case.typed}: {said}"
        expected = CAUSES.get(case.cause) or ANSWERS.get(case.typed, "")
        # Words alone: long lines are broken where the terminal ends.
        assert " ".join(expected.split()) in " ".join(said.split()), f"{case.typed} ({case.cause}): {said}"
    assert set(CAUSES) <= {case.cause for _, case, _, _ in found}
    assert set(ANSWERS) <= {case.typed for _, case, _, _ in found}


def test_the_page_of_before_and_after_has_every_mistake_once_with_both_answers(messages: ModuleType) -> None:
    causes = [case.cause for _, case, _, _ in messages.answered()]
    assert list(json.loads(messages.BEFORE.read_text("utf-8"))) == causes
    page = messages.beside()
    assert page.count("\n## ") == len(causes)
    before, after, same = (page.count(f"\n{word} (") for word in ("Before", "After", "As before"))
    assert before == after > 20
    assert after + same == len(causes)


def test_another_version_is_asked_by_a_process_of_its_own(messages: ModuleType) -> None:
    code, said = messages.said_by(ROOT, "hpe-rig chekc bovine-muscle")
    assert code == 2
    assert said.startswith("Usage: hpe-rig")
    assert "Did you mean 'check'?" in said
