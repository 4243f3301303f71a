"""Figure 15: displacement of bovine muscle against force, with regression line, offset and noise plateau."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from experiments import CHAINS, Experiment, Verdict, by, by_chain, label, panels, seeded

from hpe_rig.arrays import FloatArray
from hpe_rig.prediction import detection_floor
from hpe_rig.report import Line, fit_line
from hpe_rig.result import MARKS, ShotResult
from hpe_rig.scene import load_scene

HIGHEST = {50e-6: 9, 100e-6: 11, 200e-6: 13}
"""Number of the highest points in the paper's regression, by toneburst length (s)."""
PAPER_SLOPE_NM = {50e-6: 409.0, 100e-6: 812.0, 200e-6: 1654.0}
PAPER_OFFSET_NM = {50e-6: -75.0, 100e-6: -147.3, 200e-6: -222.1}
PAPER_R_SQUARED = {50e-6: 0.942, 100e-6: 0.976, 200e-6: 0.972}

SPECIMEN_DEPTH_M = 12.5e-3
"""Depth of the focus in the muscle: half the height of the paper's section (assumed)."""

RAYLEIGH_MEAN = 1.25
"""Mean magnitude of a noise phasor relative to the standard deviation of a quadrature."""
RAYLEIGH_95_PERCENT = 1.95
"""95 % quantile of the magnitude of a noise phasor relative to its mean: sqrt(2 ln 20) / sqrt(pi / 2)."""


@dataclass(frozen=True, slots=True)
class ForceLine:
    """Displacement against force for one T_b and chain, and lines through the highest points."""

    force: FloatArray
    nm: FloatArray
    """Displacement (force, repeat)."""
    means: Line
    single: Sequence[Line]
    """One line per repeat."""
    true: Line
    """Line through the true amplitudes with beam averaging, without noise."""

    @property
    def plateau_nm(self) -> float:
        """Mean at the two weakest forces, which move less than can be detected."""
        return float(self.nm[:2].mean())

    @property
    def deviation_nm(self) -> float:
        """Standard deviation of a single measurement above the plateau."""
        return float(np.sqrt(np.mean(self.nm[2:].var(axis=1, ddof=1))))

    def allowed_nm(self, r_squared: float) -> float:
        """Return the standard deviation of single measurements that gives this R^2 on average."""
        displacement_sd = self.means.slope * self.force[-len(self.force) // 2 :].std()
        return float(abs(displacement_sd) * np.sqrt(1 / r_squared - 1))


def figure_15(seed: int = 1) -> Experiment:
    """Measure displacement at 200 Hz against force for three toneburst lengths."""
    # Both scenes are linear by default.
    propagating = {"simulation.propagation.specimen_depth_m": SPECIMEN_DEPTH_M}
    runs = [by_chain(seeded(name, seed).with_(propagating)) for name in ("muscle-force", "muscle-force-200us")]
    figure, axes = panels(len(CHAINS) + 1)
    rows, lines = [], {}
    for chain, left in zip(CHAINS, axes, strict=False):
        shots = [shot for run in runs for shot in run[chain].shots]
        for (length_s, count), (mark, colour) in zip(HIGHEST.items(), MARKS, strict=False):
            force_line = _force_line([shot for shot in shots if shot.burst_length_s == length_s], count)
            lines[chain, length_s] = force_line
            name, top = f"T_b = {length_s * 1e6:.0f} us", force_line.force[-count:]
            mean_nm, sd_nm = force_line.nm.mean(axis=1), force_line.nm.std(axis=1, ddof=1)
            left.errorbar(force_line.force, mean_nm, sd_nm, fmt=mark, color=colour, ms=4, label=name)
            left.plot(top, force_line.means.intercept + force_line.means.slope * top, color=colour, lw=1)
            if chain == "cross_spectrum":
                axes[-1].plot(force_line.force, mean_nm, mark, color=colour, ms=4, label=name)
            rows.append((f"{length_s * 1e6:.0f} us, {CHAINS[chain]}", *_cells(force_line, length_s)))
        label(left, "force F / F_0", "displacement (nm)")
        left.set_title(f"means of five, {CHAINS[chain]}", fontsize=8)
    floor = detection_floor(load_scene("muscle-force"))
    axes[-1].axhspan(100, 200, color="0.9", label="the paper's floor")
    axes[-1].axhline(floor.detected_m * 1e9, color="0.3", ls="--", label="95 % quantile of noise")
    label(axes[-1], "force F / F_0", "displacement (nm)", xscale="log", yscale="log")
    axes[-1].set_title("the paper's chain, logarithmic axes", fontsize=8)
    header = "T_b, chain|slope, nm per F_0 (paper)|offset, nm (paper)|offset over slope (paper)|R^2 (paper)"
    header += "|R^2 of single repeats|offsets of single repeats, nm|plateau at F <= 0.04, nm"
    return Experiment(
        "Fig. 15",
        "displacement at 200 Hz against force",
        "Scenes `muscle-force` and `muscle-force-200us` with nonlinear propagation: 4 kHz, and 2.5 kHz for 200 us; T_s "
        "= 100 ms; means of five repeats, bars one standard deviation; lines through the 9, 11 and 13 highest points. "
        "F / F_0 is the square of the drive, as in the paper; the force follows from nonlinear propagation "
        "(docs/explanation/nonlinear.md). The force at full drive gives 0.8 um for 100 us, so the test compares "
        "ratios, offsets, R^2 and plateau. The paper does not state whether a point is one measurement or a mean.",
        (tuple(header.split("|")), *rows),
        figure,
        tuple(_verdicts(lines)),
    )


def _force_line(shots: Sequence[ShotResult], count: int) -> ForceLine:
    forces = by(shots, lambda shot: shot.force_fraction)
    force = np.array(list(forces))
    nm = np.array([statistics.amplitude_m[:, 1] for statistics in forces.values()]) * 1e9
    true = np.array([statistics.true_m[1] * statistics.averaging[1] for statistics in forces.values()]) * 1e9

    def line(values: FloatArray) -> Line:
        fit = fit_line(force[-count:], values[-count:])
        if fit is None:
            raise ValueError("the scenes of Fig. 15 have too few forces for a line")
        return fit

    return ForceLine(force, nm, line(nm.mean(axis=1)), [line(column) for column in nm.T], line(true))


def _cells(force_line: ForceLine, length_s: float) -> tuple[str, ...]:
    slope, offset, line = PAPER_SLOPE_NM[length_s], PAPER_OFFSET_NM[length_s], force_line.means
    fits, offsets = (
        [statistics.r_squared for statistics in force_line.single],
        [statistics.intercept for statistics in force_line.single],
    )
    return (
        f"{line.slope:.0f} +- {line.slope_u:.0f} ({slope:.0f})",
        f"{line.intercept:.0f} +- {line.intercept_u:.0f} ({offset:.0f})",
        f"{line.intercept / line.slope:.2f} ({offset / slope:.2f})",
        f"{line.r_squared:.3f} ({PAPER_R_SQUARED[length_s]:.3f})",
        f"{min(fits):.2f} to {max(fits):.2f}",
        f"{min(offsets):.0f} to {max(offsets):.0f}",
        f"{force_line.plateau_nm:.0f}",
    )


def _verdicts(lines: Mapping[tuple[str, float], ForceLine]) -> Iterator[Verdict]:
    for chain in CHAINS:
        chain_lines = {length_s: lines[chain, length_s] for length_s in HIGHEST}
        yield from _line_verdicts(chain_lines, CHAINS[chain])
        yield from _scatter_verdicts(chain_lines, chain)
    plateau_nm = [lines["cross_spectrum", length_s].plateau_nm for length_s in HIGHEST]
    reliable_nm = RAYLEIGH_95_PERCENT * float(np.mean(plateau_nm))
    yield Verdict(
        "a reliable measurement begins between 100 and 200 nm (the paper's)",
        f"95 % quantile of noise {reliable_nm:.0f} nm, from the plateau at F <= 0.04",
        100 < reliable_nm < 200,
        "proportional to trigger jitter, 1 ns in the manual of the generators",
    )


def _line_verdicts(lines: Mapping[float, ForceLine], chain_name: str) -> Iterator[Verdict]:
    """Yield the verdicts on slope and offset of the lines through the means."""
    short, middle, long = lines.values()
    fits = {length_s: line.means for length_s, line in lines.items()}
    true_ratios = ", ".join(f"{line.true.intercept / line.true.slope:.2f}" for line in lines.values())
    yield _slope_ratio(f"doubled T_b nearly doubles the slope, 50 to 100 us ({chain_name})", middle, short)
    yield _slope_ratio(f"doubled T_b nearly doubles the slope, 100 to 200 us ({chain_name})", long, middle)
    offsets = [f"{fit.intercept:.0f} +- {fit.intercept_u:.0f}" for fit in fits.values()]
    yield Verdict(
        f"the lines have negative offsets: -75, -147, -222 nm in the paper ({chain_name})",
        f"{', '.join(offsets)} nm",
        all(fit.intercept + 2 * fit.intercept_u < 0 for fit in fits.values()),
        f"without noise they are {true_ratios} of the slope; that of the shortest toneburst has an uncertainty of 50 %",
    )
    ratios = [f"{fit.intercept / fit.slope:.2f} +- {fit.intercept_u / fit.slope:.2f}" for fit in fits.values()]
    yield Verdict(
        f"offset over slope equals the paper's -0.18, -0.18, -0.13 within two standard errors ({chain_name})",
        ", ".join(ratios),
        all(
            abs(fit.intercept / fit.slope - PAPER_OFFSET_NM[length_s] / PAPER_SLOPE_NM[length_s])
            < 2 * fit.intercept_u / fit.slope
            for length_s, fit in fits.items()
        ),
        f"without noise the ratios are {true_ratios}; noise raises the weak points of a chain with a plateau of "
        f"{short.plateau_nm:.0f} nm at rest, and all three ratios lie within two standard errors in 86 of 100 cases",
    )


def _scatter_verdicts(lines: Mapping[float, ForceLine], chain: str) -> Iterator[Verdict]:
    """Yield the verdicts on R^2 of the lines, and on the plateau at weak forces."""
    short, middle, _ = lines.values()
    chain_name = CHAINS[chain]
    yield Verdict(
        f"R^2 above 0.9 for every T_b, means of five ({chain_name})",
        ", ".join(f"{line.means.r_squared:.3f}" for line in lines.values()),
        min(line.means.r_squared for line in lines.values()) > 0.9,
    )
    single = [[fit.r_squared for fit in line.single] for line in lines.values()]
    yield Verdict(
        f"R^2 above 0.9 for every T_b, single measurements ({chain_name})",
        "; ".join(f"{min(values):.2f} to {max(values):.2f}" for values in single),
        min(min(values) for values in single) > 0.9,
        f"the slope of 50 us allows a deviation of {short.allowed_nm(0.9):.0f} nm, and 1 ns of trigger jitter gives "
        f"{short.deviation_nm:.0f} nm: the paper's points are means, as in its later figures",
    )
    plateau_nm = [line.plateau_nm for line in lines.values()]
    yield Verdict(
        f"points level off between 100 and 200 nm at every T_b ({chain_name})",
        f"plateau at F <= 0.04: {', '.join(f'{nm:.0f}' for nm in plateau_nm)} nm",
        all(100 < nm < 200 for nm in plateau_nm),
        f"proportional to trigger jitter: {100 / min(plateau_nm):.1f} to {200 / max(plateau_nm):.1f} ns would give all "
        "three; the manual of the generators states 1 ns"
        if chain == "cross_spectrum"
        else f"a plain fit of noise of {middle.deviation_nm:.0f} nm in a quadrature has a plateau of "
        f"{RAYLEIGH_MEAN * middle.deviation_nm:.0f} nm; the medium prior, scaled by the data, lowers it",
    )


def _slope_ratio(statement: str, longer: ForceLine, shorter: ForceLine) -> Verdict:
    ratio = longer.means.slope / shorter.means.slope
    u = ratio * np.hypot(longer.means.slope_u / longer.means.slope, shorter.means.slope_u / shorter.means.slope)
    true_ratio = longer.true.slope / shorter.true.slope
    why = f"without noise {true_ratio:.2f}; a ratio of 2 is missed by more than 2 u by chance once in 20"
    return Verdict(statement, f"{ratio:.2f} +- {u:.2f}", abs(ratio - 2) < 2 * u, why)
