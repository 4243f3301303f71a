"""Draw the README's figure: bovine muscle measured on the twin, with the ground truth."""

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import hpe_rig as hpe
from hpe_rig.result import PALETTE, Estimate

TARGET = Path(__file__).with_name("bovine-muscle.svg")
TRACKED, ESTIMATE, *_ = PALETTE


def main() -> None:
    """Measure the shipped scene and write scripts/figures/bovine-muscle.svg."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    with TemporaryDirectory() as folder:
        result = hpe.measure("bovine-muscle", path=Path(folder) / "run.h5").estimate()
    figure = draw(result.shots[0].estimates)
    # A fixed salt and no date keep the file the same if the figure is.
    with rc_context({"svg.hashsalt": "hpe_rig", "svg.fonttype": "none"}):
        figure.savefig(TARGET, metadata={"Date": None})


def draw(estimates: tuple[Estimate, ...]) -> Figure:
    """Return two panels over frequency: amplitude in nm and phase in degrees, estimate and truth."""
    frequency_hz = [item.frequency_hz for item in estimates]
    figure = Figure(figsize=(8.4, 3.2), layout="constrained")
    amplitude_axes, phase_axes = figure.subplots(1, 2)
    true_nm = np.array([item.true_amplitude_m or np.nan for item in estimates]) * 1e9
    amplitude_axes.plot(frequency_hz, true_nm, color="0.45", label="true peak displacement")
    tracked_nm = np.array([item.tracked_amplitude_m for item in estimates]) * 1e9
    amplitude_axes.plot(frequency_hz, tracked_nm, "D", ms=4, mfc="none", color=TRACKED, label="as tracked")
    peak_m = [(item.amplitude_m, 2 * item.amplitude_uncertainty_m) for item in estimates]
    amplitude_axes.errorbar(
        frequency_hz, *(np.array(peak_m).T * 1e9), fmt="o", ms=4, color=ESTIMATE, label="peak displacement, 2 u"
    )
    amplitude_axes.set(xlabel="vibration frequency (Hz)", ylabel="displacement amplitude (nm)", ylim=(0, None))
    amplitude_axes.legend(frameon=False, fontsize=8)
    # The estimate is drawn at the unwrapped true phase plus its error, so that both are continuous.
    true_rad = np.unwrap([item.true_phase_rad or 0.0 for item in estimates])
    error_rad = np.array([item.phase_error_rad or 0.0 for item in estimates])
    phase_axes.plot(frequency_hz, np.degrees(true_rad), color="0.45", label="ground truth")
    uncertainty_deg = [2 * np.degrees(item.phase_uncertainty_rad) for item in estimates]
    phase_axes.errorbar(
        frequency_hz,
        np.degrees(true_rad + error_rad),
        uncertainty_deg,
        fmt="o",
        ms=4,
        color=ESTIMATE,
        label="estimate, 2 u",
    )
    phase_axes.set(xlabel="vibration frequency (Hz)", ylabel="phase (degrees)")
    phase_axes.legend(frameon=False, fontsize=8)
    for axes in (amplitude_axes, phase_axes):
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(alpha=0.25)
    return figure


if __name__ == "__main__":
    main()
