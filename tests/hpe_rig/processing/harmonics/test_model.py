"""Which frequencies the model of a motion takes."""

import numpy as np
import pytest

from hpe_rig.processing.harmonics.model import linear_model

TIME_S = np.arange(101) / 4000.0
SOUND = np.ones(101, dtype=bool)


def test_a_frequency_that_is_named_twice_is_refused_and_two_that_are_close_are_not() -> None:
    with pytest.raises(ValueError, match="name one twice"):
        linear_model(TIME_S, SOUND, np.array([200.0, 400.0, 200.0]))
    assert linear_model(TIME_S, SOUND, np.array([200.0, 400.0])) is not None
