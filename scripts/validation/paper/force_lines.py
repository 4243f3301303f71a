"""Figure 15: displacement of bovine muscle against force, its regression, offset and floor."""

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
"""How many of the highest samples the paper's regression takes."""
PAPER_SLOPE_NM = {50e-6: 409.0, 100e-6: 812.0, 200e-6: 1654.0}
PAPER_OFFSET_NM = {50e-6: -75.0, 100e-6: -147.3, 200e-6: -222.1}
PAPER_R_SQUARED = {50e-6: 0.942, 100e-6: 0.976, 200e-6: 0.972}

SPECIMEN_DEPTH_M = 12.5e-3
"""How deep the focus lies in the muscle: half the height of the paper's section (assumed)."""


RAYLEIGH_MEAN = 1.25
"""Mean size of a noise phasor over the deviation of a quadrature."""
ABOVE_PLATEAU = 1.95
"""What the size of a noise phasor exceeds once in 20, over its mean: sqrt(2 ln 20) / sqrt(pi / 2)."""


@dataclass(frozen=True, slots=True)
class ForceLine:
    """The points of one T_b by one chain, and lines through the highest of them."""

    force: FloatArray
    nm: FloatArray
    """(force, repeat)"""
    means: Line
    single: Sequence[Line]
    """A line a repeat."""
    true: Line
    """Through the tracked true amplitudes: without noise."""

    @property
    def plateau_nm(self) -> float:
        """Mean of the two weakest forces, at which nothing moves that could be seen."""
        return float(self.nm[:2].mean())

    @property
    def deviation_nm(self) -> float:
        """Deviation of a single measurement among the highest points."""
        return float(np.sqrt(np.mean(self.nm[2:].var(axis=1, ddof=1))))

    def allowed_nm(self, r_squared: float) -> float:
        """Return the deviation that single measurements may have for this R^2, on average."""
        moved = self.means.slope * self.force[-len(self.force) // 2 :].std()
        return float(abs(moved) * np.sqrt(1 / r_squared - 1))


def figure_15(seed: int = 1) -> Experiment:
    """Displacement at 200 Hz against force for three toneburst lengths: regression, offset and floor."""
    propagating = {"simulation.propagation.specimen_depth_m": SPECIMEN_DEPTH_M}
    runs = [by_chain(seeded(name, seed).with_(propagating)) for name in ("muscle-force", "muscle-force-200us")]
    figure, axes = panels(len(CHAINS) + 1)
    rows, found = [], {}
    for chain, left in zip(CHAINS, axes, strict=False):
        shots = [shot for run in runs for shot in run[chain].shots]
        for (length_s, count), (mark, colour) in zip(HIGHEST.items(), MARKS, strict=False):
            one = _force_line([shot for shot in shots if shot.burst_length_s == length_s], count)
            found[chain, length_s] = one
            name, top = f"T_b = {length_s * 1e6:.0f} us", one.force[-count:]
            left.errorbar(
                one.force, one.nm.mean(axis=1), one.nm.std(axis=1, ddof=1), fmt=mark, color=colour, ms=4, label=name
            )
            left.plot(top, one.means.intercept + one.means.slope * top, color=colour, lw=1)
            if chain == "cross_spectrum":
                axes[-1].plot(one.force, one.nm.mean(axis=1), mark, color=colour, ms=4, label=name)
            rows.append((f"{length_s * 1e6:.0f} us, {CHAINS[chain]}", *_cells(one, length_s)))
        label(left, "force F / F_0", "displacement (nm)")
        left.set_title(f"means of five, {CHAINS[chain]}", fontsize=8)
    floor = detection_floor(load_scene("muscle-force"))
    axes[-1].axhspan(100, 200, color="0.9", label="the paper's floor")
    axes[-1].axhline(floor.detected_m * 1e9, color="0.3", ls="--", label="noise exceeds it once in 20")
    label(axes[-1], "force F / F_0", "displacement (nm)", xscale="log", yscale="log")
    axes[-1].set_title("the same, the paper's, both axes logarithmic", fontsize=8)
    header = "T_b, chain|slope, nm per F_0 (paper)|offset, nm (paper)|offset over slope (paper)|R^2 (paper)"
    header += "|R^2 of single repeats|their offsets, nm|at F <= 0.04, nm"
    return Experiment(
        "Fig. 15",
        "displacement at 200 Hz against force",
        "Scenes `muscle-force` and `muscle-force-200us` with nonlinear propagation: 4 kHz, and 2.5 kHz for 200 us; T_s "
        "= 100 ms; means of five repeats, bars one standard deviation; lines through the 9, 11 and 13 highest points. "
        "F / F_0 is the square of the drive, as the paper has it; what the force does follows from propagation "
        "(docs/explanation/nonlinear.md), with the force at full drive set so that 100 us move 0.8 um. So ratios, offsets, "
        "R^2 and floor are the test. The paper does not say whether a point is one measurement or a mean.",
        (tuple(header.split("|")), *rows),
        figure,
        tuple(_verdicts(found)),
    )


def _force_line(shots: Sequence[ShotResult], count: int) -> ForceLine:
    forces = by(shots, lambda shot: shot.force_fraction)
    force = np.array(list(forces))
    nm = np.array([each.amplitude_m[:, 1] for each in forces.values()]) * 1e9
    true = np.array([each.true_m[1] * each.averaging[1] for each in forces.values()]) * 1e9

    def line(values: FloatArray) -> Line:
        found = fit_line(force[-count:], values[-count:])
        if found is None:
            raise ValueError("the scenes of Fig. 15 have no forces to draw a line through")
        return found

    return ForceLine(force, nm, line(nm.mean(axis=1)), [line(column) for column in nm.T], line(true))


def _cells(one: ForceLine, length_s: float) -> tuple[str, ...]:
    slope, offset, line = PAPER_SLOPE_NM[length_s], PAPER_OFFSET_NM[length_s], one.means
    fits, offsets = [each.r_squared for each in one.single], [each.intercept for each in one.single]
    return (
        f"{line.slope:.0f} +- {line.slope_u:.0f} ({slope:.0f})",
        f"{line.intercept:.0f} +- {line.intercept_u:.0f} ({offset:.0f})",
        f"{line.intercept / line.slope:.2f} ({offset / slope:.2f})",
        f"{line.r_squared:.3f} ({PAPER_R_SQUARED[length_s]:.3f})",
        f"{min(fits):.2f} to {max(fits):.2f}",
        f"{min(offsets):.0f} to {max(offsets):.0f}",
        f"{one.plateau_nm:.0f}",
    )


def _verdicts(found: Mapping[tuple[str, float], ForceLine]) -> Iterator[Verdict]:
    short, middle, long = HIGHEST
    for chain, whose in CHAINS.items():
        own = {length_s: found[chain, length_s] for length_s in HIGHEST}
        lines = {length_s: one.means for length_s, one in own.items()}
        truth = ", ".join(f"{one.true.intercept / one.true.slope:.2f}" for one in own.values())
        yield _slope_ratio(f"doubled T_b nearly doubles the slope, 50 to 100 us ({whose})", own[middle], own[short])
        yield _slope_ratio(f"doubled T_b nearly doubles the slope, 100 to 200 us ({whose})", own[long], own[middle])
        offsets = [f"{line.intercept:.0f} +- {line.intercept_u:.0f}" for line in lines.values()]
        yield Verdict(
            f"the lines have negative offsets: -75, -147, -222 nm in the paper ({whose})",
            f"{', '.join(offsets)} nm",
            all(line.intercept + 2 * line.intercept_u < 0 for line in lines.values()),
            f"without noise they are {truth} of the slope; the shortest toneburst's is known to half of itself",
        )
        yield Verdict(
            f"offset over slope as the paper's -0.18, -0.18, -0.13, within two standard errors ({whose})",
            ", ".join(
                f"{line.intercept / line.slope:.2f} +- {line.intercept_u / line.slope:.2f}" for line in lines.values()
            ),
            all(
                abs(line.intercept / line.slope - PAPER_OFFSET_NM[length_s] / PAPER_SLOPE_NM[length_s])
                < 2 * line.intercept_u / line.slope
                for length_s, line in lines.items()
            ),
            f"without noise the physics gives {truth}; noise lifts the weak points of a chain that cannot go below its "
            f"plateau, by {own[short].plateau_nm:.0f} nm at rest, and three lines within two standard errors each are "
            "so by chance in 86 of 100",
        )
        yield Verdict(
            f"R^2 above 0.9 for every T_b, means of five ({whose})",
            ", ".join(f"{line.r_squared:.3f}" for line in lines.values()),
            min(line.r_squared for line in lines.values()) > 0.9,
        )
        spans = [[one.r_squared for one in each.single] for each in own.values()]
        yield Verdict(
            f"R^2 above 0.9 for every T_b, single measurements ({whose})",
            "; ".join(f"{min(span):.2f} to {max(span):.2f}" for span in spans),
            min(min(span) for span in spans) > 0.9,
            f"the slope of 50 us allows a deviation of {own[short].allowed_nm(0.9):.0f} nm, 1 ns of trigger jitter "
            f"makes {own[short].deviation_nm:.0f} nm: the paper's points are means, as its later figures say",
        )
        plateau = [each.plateau_nm for each in own.values()]
        yield Verdict(
            f"points level off between 100 and 200 nm at every T_b ({whose})",
            f"points at F <= 0.04 settle at {', '.join(f'{nm:.0f}' for nm in plateau)} nm",
            all(100 < nm < 200 for nm in plateau),
            f"in proportion to trigger jitter: {100 / min(plateau):.1f} to {200 / max(plateau):.1f} ns would put all "
            "three there; the generators' manual says 1 ns"
            if chain == "cross_spectrum"
            else f"of {own[middle].deviation_nm:.0f} nm of noise in a quadrature a plain fit would keep "
            f"{RAYLEIGH_MEAN * own[middle].deviation_nm:.0f} nm; the prior of media, scaled by what it sees, less",
        )
    plateau = [found["cross_spectrum", length_s].plateau_nm for length_s in HIGHEST]
    reliable_nm = ABOVE_PLATEAU * float(np.mean(plateau))
    yield Verdict(
        "a reliable measurement begins between 100 and 200 nm (the paper's)",
        f"noise exceeds {reliable_nm:.0f} nm once in 20, by the plateau measured at F <= 0.04",
        100 < reliable_nm < 200,
        "in proportion to trigger jitter, of which the generators' manual says 1 ns",
    )


def _slope_ratio(statement: str, over: ForceLine, under: ForceLine) -> Verdict:
    ratio = over.means.slope / under.means.slope
    u = ratio * np.hypot(over.means.slope_u / over.means.slope, under.means.slope_u / under.means.slope)
    why = f"without noise {over.true.slope / under.true.slope:.2f}, and 2 within 2 u is missed by chance once in 20"
    return Verdict(statement, f"{ratio:.2f} +- {u:.2f}", abs(ratio - 2) < 2 * u, why)
