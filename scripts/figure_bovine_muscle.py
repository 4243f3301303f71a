"""Draw the README's figure: bovine muscle on the twin, beside the truth."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import hpe_rig as hpe
from hpe_rig.result import Estimate

FOLDER = Path(__file__).parent / "figures"
ESTIMATE = "#D55E00"


def main() -> None:
    """Measure the shipped scene and write figures/bovine-muscle.svg."""
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
    averaged = np.array([item.averaging_factor or np.nan for item in estimates])
    spread = np.array([item.speckle_relative or np.nan for item in estimates])
    left.plot(frequency_hz, true_nm, color="0.45", label="true peak displacement")
    band = (true_nm * averaged * (1 - 2 * spread), true_nm * averaged * (1 + 2 * spread))
    left.fill_between(frequency_hz, *band, color="#56B4E9", alpha=0.35, lw=0, label="predicted, 2 speckle sd")
    nm = np.array([(item.amplitude_m, 2 * item.amplitude_uncertainty_m) for item in estimates]).T * 1e9
    left.errorbar(frequency_hz, *nm, fmt="o", ms=4, color=ESTIMATE, label="estimate, 2 u")
    left.set(xlabel="vibration frequency (Hz)", ylabel="displacement amplitude (nm)", ylim=(0, None))
    left.legend(frameon=False, fontsize=8)
    truth = np.unwrap([item.true_phase_rad or 0.0 for item in estimates])
    error = np.array([item.phase_error_rad or 0.0 for item in estimates])
    right.plot(frequency_hz, np.degrees(truth), color="0.45", label="truth")
    uncertainty = [2 * np.degrees(item.phase_uncertainty_rad) for item in estimates]
    right.errorbar(
        frequency_hz, np.degrees(truth + error), uncertainty, fmt="o", ms=4, color=ESTIMATE, label="estimate"
    )
    right.set(xlabel="vibration frequency (Hz)", ylabel="phase (degrees)")
    right.legend(frameon=False, fontsize=8)
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(alpha=0.25)
    return figure


if __name__ == "__main__":
    main()
