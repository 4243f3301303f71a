"""Shear wave speed and Voigt moduli from several runs, each tracked at another distance from the push.

Usage: python scripts/shear_moduli.py RUN.h5=MM RUN.h5=MM ...
"""

from __future__ import annotations

import argparse
from pathlib import Path

from hpe_rig.acquire import process
from hpe_rig.moduli import fit_voigt, speed_of_runs


def run_at(text: str) -> tuple[Path, float]:
    """Return the run file and the distance from the push, m, of an argument such as ``near.h5=2.5``, in mm."""
    path, _, distance_mm = text.rpartition("=")
    return Path(path), float(distance_mm) * 1e-3


def main() -> None:
    """Print speed by frequency and both moduli, with standard uncertainties from the phases' noise."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("runs", nargs="+", type=run_at, metavar="RUN.h5=MM", help="a run file and its distance in mm")
    paths, distances_m = zip(*parser.parse_args().runs, strict=True)
    runs = [process(path).shots[0].estimates for path in paths]
    speed = speed_of_runs(runs, distances_m)
    for row in zip(speed.frequency_hz, speed.speed_m_per_s, speed.uncertainty_m_per_s, speed.misfit, strict=True):
        print("{:6g} Hz  {:.3f} m/s  u {:.3f}  misfit {:.3g}".format(*row))
    fit = fit_voigt(speed)
    u_elasticity, u_viscosity = fit.covariance.diagonal() ** 0.5
    print(f"mu1 {fit.elasticity_pa:.4g} Pa (u {u_elasticity:.2g})")
    print(f"mu2 {fit.viscosity_pa_s:.4g} Pa s (u {u_viscosity:.2g})")
    print(f"misfit {fit.misfit:.3g}: 1 where a plane wave in a Voigt medium and the noise explain the phases")


if __name__ == "__main__":
    main()
