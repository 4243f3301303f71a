"""No message about a malformed value begins with the words of a library."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from hpe_rig.bench.bench_file import BenchFile
from hpe_rig.scene import Scene
from hpe_rig.scene.validation import mistakes_of, models_in
from hpe_rig.study.definition import Definition
from sim_backend.settings.simulation import SimulationSettings

MALFORMED: tuple[Any, ...] = ("x", "", -1, 0, 1e400, float("nan"), True, [], [[]], ["x", -1], {}, {"x": 1}, 10**400)
LIBRARY_WORDS = (
    "Value error",
    "Assertion",
    "Input should",
    "Field required",
    "Error",
    "Extra inputs",
    "validation error",
)


def tables_with(model: Any, value: Any, depth: int = 4) -> Iterator[dict[str, Any]]:
    """Yield tables of ``model`` that hold ``value`` at one key, at every depth."""
    for name, field in model.model_fields.items():
        yield {name: value}
        for inner in models_in(field.annotation) if depth else ():
            for table in tables_with(inner, value, depth - 1):
                yield {name: table}
                yield {name: [table]}


@pytest.mark.parametrize("model", [Scene, BenchFile, SimulationSettings, Definition])
def test_every_malformed_value_is_refused_in_words_of_this_program(model: Any) -> None:
    words = {
        mistake.what
        for value in MALFORMED
        for table in tables_with(model, value)
        for mistake in mistakes_of(model, table)
    }
    assert len(words) > 20
    assert not [text for text in words if text.startswith(LIBRARY_WORDS)]
