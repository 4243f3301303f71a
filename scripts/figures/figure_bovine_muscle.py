"""Draw the README's figure: bovine muscle on the twin, beside the ground truth."""

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import hpe_rig as hpe
from hpe_rig.result import PALETTE, Estimate

FOLDER = Path(__file__).parent
TRACKED, ESTIMATE, *_ = PALETTE


def main() -> None:
    """Measure the shipped scene and write figures/bovine-muscle.svg."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    with TemporaryDirectory() as folder:
        result = hpe.measure("bovine-muscle", path=Path(folder) / "run.h5").estimate()
    FOLDER.mkdir(exist_ok=True)
    figure = draw(result.shots[0].estimates)
    with rc_context({"svg.hashsalt": "hpe_rig", "svg.fonttype": "none"}):
        figure.savefig(FOLDER / "bovine-muscle.svg", metadata={"Date": None})


def draw(estimates: tuple[Estimate, ...]) -> Figure:
    """Return two panels over frequency: amplitude in nm and phase in degrees, estimate and truth."""
    frequency_hz = [item.frequency_hz for item in estimates]
    figure = Figure(figsize=(8.4, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    true_nm = np.array([item.true_amplitude_m or np.nan for item in estimates]) * 1e9
    left.plot(frequency_hz, true_nm, color="0.45", label="true peak displacement")
    tracked_nm = np.array([item.amplitude_m for item in estimates]) * 1e9
    left.plot(frequency_hz, tracked_nm, "D", ms=4, mfc="none", color=TRACKED, label="as tracked")
    peak = [(item.headline.amplitude_m, 2 * item.headline.amplitude_uncertainty_m) for item in estimates]
    left.errorbar(
        frequency_hz, *(np.array(peak).T * 1e9), fmt="o", ms=4, color=ESTIMATE, label="peak displacement, 2 u"
    )
    left.set(xlabel="vibration frequency (Hz)", ylabel="displacement amplitude (nm)", ylim=(0, None))
    left.legend(frameon=False, fontsize=8)
    truth = np.unwrap([item.true_phase_rad or 0.0 for item in estimates])
    error = np.array([item.corrected_phase_error_rad or 0.0 for item in estimates])
    right.plot(frequency_hz, np.degrees(truth), color="0.45", label="ground truth")
    uncertainty = [2 * np.degrees(item.headline.phase_uncertainty_rad) for item in estimates]
    right.errorbar(
        frequency_hz, np.degrees(truth + error), uncertainty, fmt="o", ms=4, color=ESTIMATE, label="estimate, 2 u"
    )
    right.set(xlabel="vibration frequency (Hz)", ylabel="phase (degrees)")
    right.legend(frameon=False, fontsize=8)
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(alpha=0.25)
    return figure


if __name__ == "__main__":
    main()
