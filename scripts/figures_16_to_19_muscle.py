"""Fig. 16 to 19 on the twin: mean and deviation of displacement and phase against F, f_v, f_prf and T_s (Table II)."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from hpe_rig.result import ShotResult
from hpe_rig.run import measure, prepare, process
from hpe_rig.scene import shipped_scenes

FREQUENCIES_HZ = (100.0, 200.0, 300.0, 400.0)
BASE = "muscle-repeats"
Edits = tuple[tuple[str, str], ...]

SWEEPS: dict[str, list[tuple[str, Edits]]] = {
    "Fig. 16, 17: F": [("4 kHz", ())],
    "Fig. 18: f_prf": [
        (f"{rate_hz / 1e3:g} kHz", (("pulse_rate_hz = 4000.0", f"pulse_rate_hz = {rate_hz}"),))
        for rate_hz in (2000.0, 2500.0, 3000.0, 4000.0)
    ],
    "Fig. 19: T_s": [
        (f"{1e3 * length_s:g} ms", (("window_start_s = 50e-3", f"window_start_s = {200e-3 - length_s}"),
                                    ("window_length_s = 100e-3", f"window_length_s = {length_s}")))
        for length_s in (50e-3, 100e-3, 150e-3, 200e-3)
    ],
}  # fmt: skip


def main() -> None:
    """Measure every sweep and print its table; sweeps other than F take full force alone."""
    for title, settings in SWEEPS.items():
        print(f"\n{title}\n{'':10} {'F/F_0':>6}  " + "   ".join(f"{f:.0f} Hz: nm, deg" for f in FREQUENCIES_HZ))
        for name, edits in settings:
            one_force = (("force_fraction = [1.0, 0.81, 0.64, 0.49, 0.36]", "force_fraction = 1.0"),)
            shots = measured((*edits, *(() if "F_" in title or "17" in title else one_force)))
            for force in sorted({shot.force_fraction for shot in shots if shot.force_fraction}, reverse=True):
                print(f"{name:10} {force:6.2f}  " + row([shot for shot in shots if shot.force_fraction == force]))


def measured(edits: Edits) -> tuple[ShotResult, ...]:
    """Return the shots of the base scene with pieces of its text replaced."""
    text = shipped_scenes()[BASE]
    for old, new in edits:
        if old not in text:
            raise ValueError(f"scene {BASE} has no line {old!r}: adapt this script to it")
        text = text.replace(old, new)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "edited.toml"
        path.write_text(text, encoding="utf-8")
        return process(measure(prepare(str(path)), Path(folder) / "run.h5")).shots


def row(shots: list[ShotResult]) -> str:
    """Return mean and standard deviation over the repeats of amplitude and phase at each frequency."""
    cells = []
    for frequency_hz in FREQUENCIES_HZ:
        found = [item for shot in shots for item in shot.estimates if item.frequency_hz == frequency_hz]
        nm = np.array([item.amplitude_m for item in found]) * 1e9
        turn = np.exp(1j * np.array([item.phase_rad for item in found]))
        middle = turn.mean()
        degrees = np.degrees(np.angle(turn / middle))
        mean_deg = np.degrees(np.angle(middle))
        cells.append(f"{nm.mean():4.0f} +-{nm.std(ddof=1):3.0f} {mean_deg:5.0f} +-{degrees.std(ddof=1):3.0f}")
    return "   ".join(cells)


if __name__ == "__main__":
    main()
