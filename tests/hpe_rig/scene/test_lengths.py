"""Lengths on the command line, with their unit."""

import pytest

from hpe_rig.scene import SettingsError, length_m


@pytest.mark.parametrize(("text", "metres"), [("20nm", 20e-9), (" 1.5 um", 1.5e-6), ("2e-8", 2e-8), ("0.001mm", 1e-6)])
def test_lengths_are_read_with_their_unit(text: str, metres: float) -> None:
    assert length_m(text, "--target") == pytest.approx(metres, rel=1e-12, abs=0)


@pytest.mark.parametrize("text", ["20", "", "nm", "20 feet", "-3nm", "0", "1e400"])
def test_what_is_no_length_is_refused_by_name(text: str) -> None:
    with pytest.raises(SettingsError, match="--target"):
        length_m(text, "--target")
