"""A medium of another package in the twin: one that hangs or ends the program is an error that names it."""

from __future__ import annotations

import threading
from types import SimpleNamespace

import numpy as np
import pytest

from sim_backend.settings import installed_media

PARAMETER = SimpleNamespace(name="mu_pa", limits=(0.0, 1e6))


def modulus_with(monkeypatch: pytest.MonkeyPatch, modulus: object) -> np.ndarray:
    law = SimpleNamespace(parameters=(PARAMETER,), modulus=modulus)
    entry = SimpleNamespace(load=lambda: law, dist=SimpleNamespace(name="foam", version="2.0"))
    monkeypatch.setattr(installed_media, "_installed", lambda: {"foam": entry})
    installed_media._law.cache_clear()
    return installed_media.modulus_of("foam", {"mu_pa": 4e3}, np.array([[1j, 2j]]))


def test_a_medium_gives_its_modulus_in_the_shape_of_the_frequencies(monkeypatch: pytest.MonkeyPatch) -> None:
    modulus_pa = modulus_with(monkeypatch, lambda s, values: (values[0] * (1 + s), None))
    np.testing.assert_array_equal(modulus_pa, 4e3 * (1 + np.array([[1j, 2j]])))


def test_a_medium_that_hangs_or_ends_the_program_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    released = threading.Event()
    monkeypatch.setattr(installed_media, "TIMEOUT_S", 0.05)
    with pytest.raises(
        ValueError, match=r"medium foam .*of foam 2\.0.*has not returned within 0\.05 s.*report it there"
    ):
        modulus_with(monkeypatch, lambda s, values: released.wait(20))
    released.set()
    monkeypatch.setattr(installed_media, "TIMEOUT_S", 20.0)
    with pytest.raises(ValueError, match=r"medium foam .*SystemExit"):
        modulus_with(monkeypatch, lambda s, values: exit(0))
