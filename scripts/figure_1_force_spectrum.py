"""Fig. 1 on the twin: the force spectrum of T_b = 100 us at f_r = 200 Hz, from what the toneburst generator emits."""

import numpy as np

from sim_backend.edges import Bursts
from sim_backend.force import radiation_force
from sim_backend.settings import Specimen

RATE_HZ, LENGTH_PS = 200.0, 100_000_000


def main() -> None:
    """Print the harmonics' magnitudes relative to the first, and the zeros at multiples of 1 / T_b."""
    one = np.ones(1)
    burst = Bursts(np.zeros(1, np.int64), np.full(1, LENGTH_PS), 3e6 * one, 300 * one, one)
    force = radiation_force(burst, Specimen(), 45e-6)
    harmonic = np.arange(1, 151)
    omega = 2 * np.pi * RATE_HZ * harmonic
    edges_s = (force.end_ps[0] * 1e-12, force.onset_ps[0] * 1e-12)
    spectrum = np.abs((np.exp(-1j * omega * edges_s[0]) - np.exp(-1j * omega * edges_s[1])) / omega)
    relative = spectrum / spectrum[0]
    for n in (1, 2, 3, 4, 5, 25, 49, 50, 51, 100, 150):
        print(f"{n * RATE_HZ / 1e3:6.1f} kHz  {relative[n - 1]:.6f}")
    print(f"flat to 1 kHz within {100 * (1 - relative[4]):.2f} %; at 10, 20, 30 kHz below {relative[49::50].max():.0e}")


if __name__ == "__main__":
    main()
