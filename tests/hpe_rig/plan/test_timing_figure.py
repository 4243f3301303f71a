"""The timing diagram: every interval at its time and as long as it lasts, from the first toneburst on."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from hpe_rig import result
from hpe_rig.bench import read_bench
from hpe_rig.plan import make_plan, timing_pictures
from hpe_rig.scene import parse_scene, shipped_scenes

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def bars_of(figure: Figure) -> dict[str, list[tuple[float, float]]]:
    """Return start and length of every bar, by the name of its row."""
    (axes,) = figure.axes
    names = [label.get_text() for label in axes.get_yticklabels()]
    extents = [[path.get_extents() for path in row.get_paths()] for row in axes.collections]
    return {name: [(box.x0, box.width) for box in boxes] for name, boxes in zip(names, extents, strict=True)}


@pytest.mark.parametrize("name", ["bovine-muscle", "table-1"])
def test_intervals_are_drawn_when_they_are_and_as_long_as_they_last(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(result, "picture", lambda figure, *_: figure)
    shot = make_plan(parse_scene(name, shipped_scenes()[name]).scene, read_bench().bench).shots[0]
    line = shot.timeline
    whole, close = timing_pictures(shot)
    pushes = line.burst_onset_s.size > 0
    start_s = float((line.burst_onset_s if pushes else line.pulse_onset_s)[0])
    span_s = 1 / shot.burst_train.rate_hz if shot.burst_train else 8 / shot.tracking_train.rate_hz
    first_s = next(float(onset_s) for onset_s in line.pulse_onset_s if onset_s >= start_s)
    for figure, end_s in ((whole, span_s), (close, first_s - start_s + 1.1 * line.record_offset_s[1])):
        unit_s = 1e-3 if end_s > 2e-3 else 1e-6
        assert figure.axes[0].get_xlim() == pytest.approx((0, end_s / unit_s), rel=1e-9)
        intervals = {
            "gate": (line.pulse_onset_s, line.gate_offset_s),
            "record": (line.pulse_onset_s, line.record_offset_s),
            "tracking pulse": (line.pulse_onset_s, (0.0, line.pulse_length_s)),
        }
        if pushes:
            intervals["toneburst"] = line.burst_onset_s, (0.0, line.burst_length_s)
            # What the last cycle sends reaches the gate's far end and comes back.
            intervals["its echoes"] = line.burst_onset_s, (0.0, line.burst_length_s + line.gate_offset_s[1])
        found = bars_of(figure)
        assert set(found) == set(intervals)
        for row, (onsets_s, (low_s, high_s)) in intervals.items():
            seen_s = [each for each in onsets_s if each + high_s >= start_s and each + low_s <= start_s + end_s]
            # A bar is at least a pixel wide, which is a 400th of the axis.
            length = max(high_s - low_s, end_s / 400) / unit_s
            expected = [((each + low_s - start_s) / unit_s, length) for each in seen_s]
            assert len(found[row]) == len(expected), row
            for bar, wanted in zip(found[row], expected, strict=True):
                assert bar == pytest.approx(wanted, rel=1e-6, abs=1e-6), row


def test_the_words_for_who_cannot_see_the_diagram_hold_the_times() -> None:
    shot = make_plan(parse_scene("bovine-muscle", shipped_scenes()["bovine-muscle"]).scene, read_bench().bench).shots[0]
    line = shot.timeline
    burst_s = line.burst_onset_s[0]
    first_us = 1e6 * min(pulse_s - burst_s for pulse_s in line.pulse_onset_s if pulse_s >= burst_s)
    low_us, high_us = (1e6 * edge for edge in line.gate_offset_s)
    said = timing_pictures(shot)[0].alt
    assert f"a toneburst of {line.burst_length_s * 1e6:g} us" in said
    assert f"the first tracking pulse follows after {first_us:.4g} us" in said
    assert f"each gate is open {low_us:.2f} to {high_us:.2f} us after" in said
