"""The paper's experiments on the twin: repeats as arrays, and a page with figure, table and verdicts of each."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import h5py
import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hpe_rig.arrays import FloatArray
from hpe_rig.measurement import prepare, record_run
from hpe_rig.plan import select
from hpe_rig.processing import Motion, least_squares
from hpe_rig.result import STYLE, Estimate, Result, ShotResult
from hpe_rig.runs import process
from hpe_rig.scene import Scene, SceneSource, load_scene


@dataclass(frozen=True, slots=True)
class Verdict:
    """A statement of the paper, or a requirement on the twin, and the result of the experiment.

    ``why`` explains a statement that is missed or met in part; it is shown only then.
    """

    statement: str
    finding: str
    met: bool | np.bool_
    why: str = ""


@dataclass(frozen=True, slots=True)
class Experiment:
    """One experiment: ``method`` describes it, ``table`` holds the header and the rows."""

    key: str
    title: str
    method: str
    table: tuple[tuple[str, ...], ...]
    figure: Figure
    verdicts: tuple[Verdict, ...]


@dataclass(frozen=True, slots=True)
class Repeated:
    """Repeats at one setting.

    ``amplitude_m`` (repeat, frequency). The others (frequency,): mean and standard deviation over the repeats, with the
    mean phase unwrapped over frequency; the true amplitude, and the beam-averaging factor.
    """

    frequency_hz: FloatArray
    amplitude_m: FloatArray
    mean_nm: FloatArray
    sd_nm: FloatArray
    mean_deg: FloatArray
    sd_deg: FloatArray
    true_m: FloatArray
    averaging: FloatArray
    noise_nm: FloatArray
    """Stated uncertainty of one repeat due to noise and trigger jitter, which repeats average."""
    systematic_nm: FloatArray
    """Stated uncertainty due to speckle and aliasing, which all repeats share."""

    @property
    def u_nm(self) -> FloatArray:
        """Stated uncertainty of the means, nm (frequency,)."""
        return np.asarray(np.hypot(self.noise_nm / np.sqrt(len(self.amplitude_m)), self.systematic_nm))

    @property
    def error_nm(self) -> float:
        """Standard error of a mean amplitude, pooled over the frequencies."""
        return float(np.sqrt(np.mean(self.sd_nm**2) / len(self.amplitude_m)))


def seeded(name: str, seed: int) -> Scene:
    """Return a shipped scene with scatterers, noise and jitter drawn by ``seed``."""
    return load_scene(name).with_({"simulation.seed": seed})


def result_of(scene: SceneSource) -> Result:
    """Measure a scene and return its result."""
    return result_and_sampled_truth(scene)[0]


CHAINS = {"coherent": "ours", "cross_spectrum": "the paper's"}
"""Estimators compared in Figs. 15 to 19: the default of the program, and the paper's chain with its filter."""


def by_chain(scene: SceneSource) -> dict[str, Result]:
    """Measure a scene once and return the result of each of `CHAINS` from the same records."""
    setup = prepare(scene)
    with TemporaryDirectory() as folder:
        run_file = record_run(setup, Path(folder) / "run.h5")
        return {chain: process(run_file, chain) for chain in CHAINS}


def result_and_sampled_truth(scene: SceneSource) -> tuple[Result, FloatArray]:
    """Measure a scene; return its result, and amplitudes (shot, frequency), m, fitted to the true motion at the pulses.

    The latter include aliasing.
    """
    setup = prepare(scene)
    with TemporaryDirectory() as folder:
        run_file = record_run(setup, Path(folder) / "run.h5")
        with h5py.File(run_file) as file:
            true_m = file["truth/displacement_m"][...]
        result = process(run_file)
    sampled_m = []
    for shot, row_m in zip(setup.plan.shots, true_m, strict=True):
        # Fit the true motion at the selected pulses with the harmonics of the estimate.
        pulses = select(setup.scene.scene, shot)
        time_s = shot.timeline.sensing_s[pulses.window]
        motion = Motion(time_s, row_m[pulses.window], np.zeros(time_s.size), np.ones(time_s.size, bool))
        sampled_m.append(least_squares(motion, pulses.wanted_hz, also_hz=pulses.driven_hz).amplitude_m)
    return result, np.array(sampled_m)


def repeated(shots: Sequence[ShotResult]) -> Repeated:
    """Return the statistics of the repeats of one setting."""
    estimates = [shot.estimates for shot in shots]
    amplitude_m = np.array([[item.tracked_amplitude_m for item in row] for row in estimates])
    # Phases are averaged on the unit circle.
    phasor = np.exp(1j * np.array([[item.tracked_phase_rad for item in row] for row in estimates]))
    mean_phasor = phasor.mean(axis=0)
    return Repeated(
        frequency_hz=np.array([item.frequency_hz for item in estimates[0]]),
        amplitude_m=amplitude_m,
        mean_nm=amplitude_m.mean(axis=0) * 1e9,
        sd_nm=amplitude_m.std(axis=0, ddof=1) * 1e9,
        mean_deg=np.degrees(np.unwrap(np.angle(mean_phasor))),
        sd_deg=np.degrees(np.angle(phasor / mean_phasor).std(axis=0, ddof=1)),
        true_m=np.array([[item.true_amplitude_m or np.nan for item in row] for row in estimates]).mean(axis=0),
        averaging=np.array([item.averaging_factor or np.nan for item in estimates[0]]),
        noise_nm=_stated_nm(estimates, ("noise", "trigger jitter")),
        systematic_nm=_stated_nm(estimates, ("speckle", "aliasing")),
    )


def _stated_nm(estimates: Sequence[Sequence[Estimate]], sources: Sequence[str]) -> FloatArray:
    """Return the stated uncertainty of one repeat due to these sources, nm, as root mean square over the repeats."""
    variance_m2 = [
        [sum(part.amplitude_m**2 for part in item.components if part.source in sources) for item in row]
        for row in estimates
    ]
    return np.asarray(np.sqrt(np.mean(variance_m2, axis=0)) * 1e9)


def by(shots: Sequence[ShotResult], setting: Callable[[ShotResult], float | None]) -> dict[float, Repeated]:
    """Return the repeats at each value of ``setting``, in ascending order."""
    values = sorted({setting(shot) or 0.0 for shot in shots})
    return {value: repeated([shot for shot in shots if (setting(shot) or 0.0) == value]) for value in values}


def panels(count: int) -> tuple[Figure, list[Axes]]:
    """Return a figure with ``count`` panels side by side."""
    with rc_context(STYLE):
        figure = Figure(figsize=(3.6 * count, 3.1), layout="constrained")
        axes = figure.subplots(1, count, squeeze=False).ravel().tolist()
    return figure, axes


def letter(axes: Sequence[Axes]) -> None:
    """Title the panels (a), (b), ... as in the paper."""
    for panel, sign in zip(axes, "abcdef", strict=False):
        panel.set_title(f"({sign})", loc="left", fontsize=8)


def label(axes: Axes, x: str, y: str, **more: Any) -> None:
    """Label the axes of a panel, and add a legend if curves have labels."""
    axes.set(xlabel=x, ylabel=y, **more)
    if axes.get_legend_handles_labels()[1]:
        axes.legend(frameon=False, fontsize=7)


MET, PARTLY = 0.75, 0.25
"""Fraction of the seeds from which a statement is met, or met in part."""
Tally = Mapping[tuple[str, str], Sequence[bool]]
"""Whether a statement, by experiment and text, is met with each additional seed."""


def write_page(experiments: Sequence[Experiment], folder: Path, tally: Tally | None = None) -> Path:
    """Write a page in Markdown and one figure per experiment; return the path of the page.

    ``tally`` holds the verdicts of the same statements with other seeds of scatterers, noise and jitter.
    """
    folder.mkdir(parents=True, exist_ok=True)
    rows, words = [], []
    for item in experiments:
        for verdict in item.verdicts:
            met = [bool(verdict.met), *(tally or {}).get((item.key, verdict.statement), ())]
            fraction = sum(met) / len(met)
            word = "met" if fraction >= MET else "in part" if fraction >= PARTLY else "missed"
            words.append(word)
            seeds = f"{sum(met)} of {len(met)}" if len(met) > 1 else ""
            verdict_cells = (seeds, "met", "") if word == "met" else (seeds, f"**{word}**", verdict.why)
            rows.append((item.key, verdict.statement, verdict.finding, *verdict_cells))
    count = ", ".join(f"{words.count(word)} {word}" for word in ("met", "in part", "missed"))
    lines = ["# The paper's experiments on the twin", ""]
    lines += [
        f"**{len(rows)} statements: {count}.** Each experiment has a figure and a table.",
        "",
        "Five repeats of one specimen are few, so scatterers, noise and jitter were drawn again with other seeds. A "
        "statement is met if it holds for three quarters of the seeds, and met in part if for a quarter. Findings and "
        "figures are those of the first seed. Amplitudes and phases are those tracked by each chain. The paper's chain "
        "is not corrected by the medium prior, which the headline of that estimator in this program is.",
        "",
    ]
    lines += _markdown((("", "statement", "finding", "seeds", "", "why"), *rows))
    for item in experiments:
        name = f"{item.key.lower().replace(' ', '-').replace('.', '').replace(',', '')}.svg"
        with rc_context(STYLE):
            item.figure.savefig(folder / name, metadata={"Date": None})
        lines += ["", f"## {item.key}: {item.title}", "", item.method, "", f"![{item.title}]({name})", ""]
        lines += _markdown(item.table)
    path = folder / "beside-the-paper.md"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def _markdown(table: Sequence[Sequence[str]]) -> list[str]:
    header, *rows = (f"|{'|'.join(f' {cell} ' if cell else ' ' for cell in row)}|" for row in table)
    return [header, "|" + "---|" * len(table[0]), *rows]
