"""Fig. 14 on the twin: displacement against frequency of the 8, 12 and 15 % gelatins, beside the truth."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from hpe_rig.run import measure, prepare, process


def main() -> None:
    """Print mean and spread over the repeats in nm, relative to 100 Hz, and the true peak displacement."""
    for scene in ("gelatin-8", "gelatin-12", "gelatin-15"):
        with TemporaryDirectory() as folder:
            result = process(measure(prepare(scene), Path(folder) / "run.h5"))
        estimates = [shot.estimates for shot in result.shots]
        nm = np.array([[item.amplitude_m for item in shot] for shot in estimates]) * 1e9
        true_nm = [(item.true_amplitude_m or np.nan) * 1e9 for item in estimates[0]]
        mean_nm, spread_nm = nm.mean(axis=0), nm.std(axis=0, ddof=1)
        print(f"\n{scene}\n  f (Hz)  measured (nm)     relative   true peak (nm)")
        for item, mean, spread, true in zip(estimates[0], mean_nm, spread_nm, true_nm, strict=True):
            print(f"  {item.frequency_hz:6.0f}  {mean:6.0f} +- {spread:4.0f}  {mean / mean_nm[0]:10.3f}  {true:10.0f}")


if __name__ == "__main__":
    main()
