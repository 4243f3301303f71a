"""Scene of an import."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest


@pytest.fixture
def scene_of_gate(tmp_path: Path) -> Callable[[float, float, float], Path]:
    """Return a function that writes a scene with a gate of a depth and length, m, and one frequency, Hz."""

    def write(depth_m: float, length_m: float, frequency_hz: float) -> Path:
        path = tmp_path / "scene.toml"
        path.write_text(
            'title = "Echoes of another program"\n[tracking]\n[acquisition]\n'
            f"gate_depth_m = {depth_m}\ngate_length_m = {length_m}\n"
            f'[processing]\nfrequencies_hz = [{frequency_hz}]\nharmonic = "least_squares"\n'
        )
        return path

    return write
