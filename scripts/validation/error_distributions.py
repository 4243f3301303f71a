"""Distributions of errors that are not normal: speckle, and speckle with a force of unknown width.

Usage: python scripts/validation/error_distributions.py [FOLDER]     default folder of the figure: docs/figures

u is the standard deviation of an error of any distribution: the mean of (error / u)^2 is 1, but the fraction within u
is not that of a normal error. The figure shows the relative error of the tracked amplitude due to speckle in the scene
`table-1`, without and with the Hann window of the paper's chain. The third error is the first divided by the square of
a log-normal width (0.3): in `bovine-muscle` the phase error due to speckle has this form.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import hpe_rig as hpe
from hpe_rig.arrays import FloatArray
from hpe_rig.prediction import draw_speckle, resting_conditions, tracked_over_peak

DRAWS = 20_000
WIDTH_LOG_SD = 0.3
"""Standard deviation of the logarithm of the force's width, as in the prior's `BeamWidths`."""
K_95 = 1.959964
BINS = np.linspace(-4, 4, 65)


def speckle(estimator: str) -> FloatArray:
    """Return the error of the tracked amplitude relative to its standard deviation, (draw,)."""
    resting = resting_conditions(hpe.load_scene("table-1"))
    assert resting is not None
    ratio = tracked_over_peak(resting, estimator, draw_speckle(resting, np.random.default_rng(1), DRAWS))
    return np.asarray((ratio - ratio.mean()) / ratio.std())


def with_width(error: FloatArray) -> FloatArray:
    """Return ``error`` for a force of unknown width: the gradient of the motion is proportional to 1 / width²."""
    # Log-normal widths, seeded independently of the speckle.
    gradient = np.exp(-2 * WIDTH_LOG_SD * np.random.default_rng(2).standard_normal(error.size))
    return np.asarray(error * gradient / np.sqrt(np.mean((error * gradient) ** 2)))


def summary(name: str, error: FloatArray) -> str:
    """Return a row with the percentages of ``error`` (in u) within u and 1.96 u, its mean square and kurtosis."""
    percentages = [100 * float(np.mean(np.abs(error) < k)) for k in (1.0, K_95)]
    square = float(np.mean(error**2))
    kurtosis = float(np.mean(error**4)) / square**2
    within_u, within_k = (f"{value:.0f} %" for value in percentages)
    return f"| {name} | {within_u} | {within_k} | {square:.2f} | {kurtosis:.1f} |"


def draw(errors: dict[str, FloatArray]) -> Figure:
    """Draw the densities of ``errors`` (in u) and that of a normal error."""
    figure = Figure(figsize=(7.4, 2.5), layout="constrained")
    for axes, (name, error) in zip(figure.subplots(1, len(errors), sharey=True), errors.items(), strict=True):
        axes.hist(np.clip(error.ravel(), *BINS[[0, -1]]), BINS, density=True, color="#0072B2", alpha=0.8)
        axes.plot(BINS, np.exp(-(BINS**2) / 2) / np.sqrt(2 * np.pi), color="#D55E00", label="normal")
        axes.set(xlabel="error over u", title=name)
        axes.title.set_size(8)
        axes.spines[["top", "right"]].set_visible(False)
    figure.axes[0].set_ylabel("density")
    figure.axes[0].legend(frameon=False, fontsize=8)
    return figure


def main() -> None:
    """Print the table and write error-distributions.svg."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default = Path(__file__).parents[2] / "docs" / "figures"
    parser.add_argument("folder", nargs="?", type=Path, default=default, help="folder of the figure")
    path = parser.parse_args().folder
    coherent = speckle("coherent")
    errors = {
        "speckle, table-1": coherent,
        "speckle, gate with Hann window": speckle("cross_spectrum"),
        "speckle, force of unknown width": with_width(coherent),
    }
    print("| error | within u | within 1.96 u | NEV | kurtosis |", "|---|---:|---:|---:|---:|", sep="\n")
    print(*(summary(name, error) for name, error in errors.items()), sep="\n")
    path.mkdir(parents=True, exist_ok=True)
    with rc_context({"svg.hashsalt": "hpe_rig", "svg.fonttype": "none"}):
        draw(errors).savefig(path / "error-distributions.svg", metadata={"Date": None})


if __name__ == "__main__":
    main()
