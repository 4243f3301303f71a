"""Step response without a table: the inverse Laplace transform summed anew at every instant."""

from collections.abc import Callable

import numpy as np
import pytest

from sim_backend.motion.specimen import transfer


@pytest.fixture(scope="session")
def step_response() -> Callable[..., np.ndarray]:
    """Return the displacement at times (time,) > 0 after a unit force was switched on, m per N/m^3."""

    def summed(specimen, width_m, time_s):
        height, angle, step = 6.0, 0.65, 3.5 / 32
        turned = 1j * (np.arange(32) + 0.5) * step - angle
        # S(t) = 1/(2 pi j) int exp(s t) U(s)/s ds along s = (height/t) (1 + sin(j x - angle)), its upper half doubled.
        scaled, slope = height * (1 + np.sin(turned)), height * np.cos(turned)
        values = [transfer(specimen, width_m, scaled / time) for time in time_s.tolist()]
        return np.array([(np.exp(scaled) * slope / scaled * value).sum().real * step / np.pi for value in values])

    return summed
