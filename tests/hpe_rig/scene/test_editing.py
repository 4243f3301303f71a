"""Numbers of a scene are found by short names, and its text keeps everything but the numbers that change."""

from __future__ import annotations

import tomllib

import pytest

from hpe_rig.scene import (
    Key,
    Mistake,
    SettingsError,
    edited_text,
    number_keys,
    resolve,
    scene_text,
    shipped_scenes,
    with_values,
)

FAST = {"bovine-muscle-aperture", "muscle-force"}
"""The other scenes are marked slow."""


def test_short_names_are_found_where_they_are_unambiguous() -> None:
    keys = number_keys(tomllib.loads(scene_text("bovine-muscle")[1]))
    found = resolve("pulse_rate_hz", keys)
    assert isinstance(found, Key)
    assert str(found) == "tracking.pulse_rate_hz"
    twice, many = resolve("carrier_hz", keys), resolve("tracking_width_m", keys)
    assert isinstance(twice, Mistake)
    assert twice.remedy == "one of excitation.carrier_hz, tracking.carrier_hz"
    assert isinstance(many, Mistake)
    assert "tracking_width_m[2]" in many.remedy
    assert isinstance(resolve("beams.tracking_width_m[2]", keys), Key)


def test_a_scenes_text_keeps_its_comments() -> None:
    text = scene_text("muscle-force")[1]
    values = {
        ("processing", "window_start_s"): 0.06,
        ("tracking", "pulse_count"): 77,
        ("beams", "tracking_width_m", 1): 9e-5,
        ("simulation", "scatterers", "per_cell"): 12.0,
    }
    new = edited_text(text, values)
    assert "window_start_s = 0.06     # leave out the start-up transient" in new
    unchanged = set(text.splitlines()) - set(new.splitlines())
    assert len(unchanged) == 2
    assert tomllib.loads(new)["simulation"]["scatterers"]["per_cell"] == 12.0


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=() if name in FAST else pytest.mark.slow) for name in shipped_scenes()],
)
def test_every_number_of_a_scene_can_be_changed_and_no_line_but_its_own_differs(name: str) -> None:
    text = shipped_scenes()[name]
    tables = tomllib.loads(text)
    for key in number_keys(tables):
        values = {key.path: int(key.value or 0) + 1 if key.is_integer else float(key.value or 0) + 0.5}
        new = edited_text(text, values)
        assert tomllib.loads(new) == with_values(tables, values)
        kept = set(text.splitlines()) - set(new.splitlines())
        assert len(kept) <= 1, key


def test_a_new_key_follows_its_sections_others_and_leaves_the_next_sections_comment_there() -> None:
    text = "[tracking]\npulse_rate_hz = 1.0  # slow\n\n# the gate\n[acquisition]\nrepeats = 1\n"
    new = edited_text(text, {("tracking", "delay_s"): 2e-6})
    assert new == text.replace("# slow\n", "# slow\ndelay_s = 2e-06\n")


def test_inline_tables_and_dotted_keys_are_edited_where_they_stand() -> None:
    values = {("tracking", "pulse_rate_hz"): 2.0}
    assert edited_text("tracking = { pulse_rate_hz = 1.0 }", values) == "tracking = { pulse_rate_hz = 2.0 }"
    assert edited_text("tracking.pulse_rate_hz = 1.0 # slow", values) == "tracking.pulse_rate_hz = 2.0 # slow"


def test_every_value_without_a_place_is_named() -> None:
    values = {("beams", "tracking_width_m", 3): 1.0, ("title", "length_m"): 1.0}
    with pytest.raises(SettingsError) as caught:
        edited_text('title = "a"\n[beams]\ntracking_width_m = [1.0, 2.0, 3.0]', values)
    assert [mistake.path for mistake in caught.value.mistakes] == ["beams.tracking_width_m[3]", "title.length_m"]
