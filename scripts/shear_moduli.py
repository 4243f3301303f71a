"""Shear wave speed and Voigt moduli from several runs, each tracked at another distance from the push: RUN.h5=MM ..."""

from __future__ import annotations

import sys
from pathlib import Path

from hpe_rig.acquire import process
from hpe_rig.moduli import fit_voigt, speed_of_runs


def main(arguments: list[str]) -> None:
    """Print speed by frequency and both moduli, with standard uncertainties from the phases' noise."""
    pairs = [argument.rsplit("=", 1) for argument in arguments]
    runs = [process(Path(path)).shots[0].estimates for path, _ in pairs]
    speed = speed_of_runs(runs, [float(place) * 1e-3 for _, place in pairs])
    for row in zip(speed.frequency_hz, speed.speed_m_per_s, speed.uncertainty_m_per_s, speed.misfit, strict=True):
        print("{:6g} Hz  {:.3f} m/s  u {:.3f}  misfit {:.3g}".format(*row))
    fit = fit_voigt(speed)
    u_elasticity, u_viscosity = fit.covariance.diagonal() ** 0.5
    print(f"mu1 {fit.elasticity_pa:.4g} Pa (u {u_elasticity:.2g})")
    print(f"mu2 {fit.viscosity_pa_s:.4g} Pa s (u {u_viscosity:.2g})")
    print(f"misfit {fit.misfit:.3g}: 1 where a plane wave in a Voigt medium and the noise explain the phases")


if __name__ == "__main__":
    main(sys.argv[1:])
