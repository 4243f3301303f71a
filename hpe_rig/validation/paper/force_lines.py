"""Figure 15: displacement of bovine muscle against force, its regression, offset and floor."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from hpe_rig.prediction import detection_floor
from hpe_rig.report import Line, fit_line
from hpe_rig.result import MARKS
from hpe_rig.scene import load_scene
from hpe_rig.validation.paper.experiments import CHAINS, Experiment, Verdict, by, by_chain, label, panels, seeded

HIGHEST = {50e-6: 9, 100e-6: 11, 200e-6: 13}
"""How many of the highest samples the paper's regression takes."""
PAPER_SLOPE_NM = {50e-6: 409.0, 100e-6: 812.0, 200e-6: 1654.0}
PAPER_OFFSET_NM = {50e-6: -75.0, 100e-6: -147.3, 200e-6: -222.1}
PAPER_R_SQUARED = {50e-6: 0.942, 100e-6: 0.976, 200e-6: 0.972}

SPECIMEN_DEPTH_M = 12.5e-3
"""How deep the focus lies in the muscle: half the height of the paper's section (assumed)."""


def figure_15(seed: int = 1) -> Experiment:
    """Displacement at 200 Hz against force for three toneburst lengths: regression, offset and floor."""
    propagating = {"simulation.propagation.specimen_depth_m": SPECIMEN_DEPTH_M}
    runs = [by_chain(seeded(name, seed).with_(propagating)) for name in ("muscle-force", "muscle-force-200us")]
    figure, axes = panels(len(CHAINS) + 1)
    rows, lines, single, settled = [], {}, {}, {}
    for chain, left in zip(CHAINS, axes, strict=False):
        shots = [shot for run in runs for shot in run[chain].shots]
        for (length_s, count), (mark, colour) in zip(HIGHEST.items(), MARKS, strict=False):
            forces = by([shot for shot in shots if shot.burst_length_s == length_s], lambda shot: shot.force_fraction)
            force = np.array(list(forces))
            nm = np.array([each.amplitude_m[:, 1] for each in forces.values()]) * 1e9
            top = slice(-count, None)
            line = fit_line(force[top], nm[top].mean(axis=1))
            each = [one for k in range(nm.shape[1]) if (one := fit_line(force[top], nm[top, k])) is not None]
            if line is None:
                raise ValueError("the scenes of Fig. 15 have no forces to draw a line through")
            key = chain, length_s
            lines[key], single[key], settled[key] = line, each, nm[:2].mean()
            name = f"T_b = {length_s * 1e6:.0f} us"
            left.errorbar(force, nm.mean(axis=1), nm.std(axis=1, ddof=1), fmt=mark, color=colour, ms=4, label=name)
            left.plot(force[top], line.intercept + line.slope * force[top], color=colour, lw=1)
            if chain == "cross_spectrum":
                axes[-1].plot(force, nm.mean(axis=1), mark, color=colour, ms=4, label=name)
            rows.append(
                (
                    f"{length_s * 1e6:.0f} us, {CHAINS[chain]}",
                    f"{line.slope:.0f} +- {line.slope_u:.0f} ({PAPER_SLOPE_NM[length_s]:.0f})",
                    f"{line.intercept:.0f} +- {line.intercept_u:.0f} ({PAPER_OFFSET_NM[length_s]:.0f})",
                    f"{line.intercept / line.slope:.2f} ({PAPER_OFFSET_NM[length_s] / PAPER_SLOPE_NM[length_s]:.2f})",
                    f"{line.r_squared:.3f} ({PAPER_R_SQUARED[length_s]:.3f})",
                    f"{min(one.r_squared for one in each):.2f} to {max(one.r_squared for one in each):.2f}",
                    f"{min(one.intercept for one in each):.0f} to {max(one.intercept for one in each):.0f}",
                    f"{settled[key]:.0f}",
                )
            )
        label(left, "force F / F_0", "displacement (nm)")
        left.set_title(f"means of five, {CHAINS[chain]}", fontsize=8)
    floor = detection_floor(load_scene("muscle-force"))
    axes[-1].axhspan(100, 200, color="0.9", label="the paper's floor")
    axes[-1].axhline(floor.detected_m * 1e9, color="0.3", ls="--", label="noise exceeds it once in 20")
    label(axes[-1], "force F / F_0", "displacement (nm)", xscale="log", yscale="log")
    header = "T_b, chain|slope, nm per F_0 (paper)|offset, nm (paper)|offset over slope (paper)|R^2 (paper)"
    header += "|R^2 of single repeats|their offsets, nm|at F <= 0.04, nm"
    return Experiment(
        "Fig. 15",
        "displacement at 200 Hz against force",
        "Scenes `muscle-force` and `muscle-force-200us` with nonlinear propagation: 4 kHz, and 2.5 kHz for 200 us; T_s "
        "= 100 ms; means of five repeats, bars one standard deviation; lines through the 9, 11 and 13 highest points. "
        "F / F_0 is the square of the drive, as the paper has it; what the force does follows from propagation "
        "(docs/theory/nonlinear.md), with the force at full drive set so that 100 us move 0.8 um. So ratios, offsets, "
        "R^2 and floor are the test. The paper does not say whether a point is one measurement or a mean.",
        (tuple(header.split("|")), *rows),
        figure,
        tuple(_figure_15_verdicts(lines, single, settled, floor.detected_m * 1e9)),
    )


def _figure_15_verdicts(
    lines: Mapping[tuple[str, float], Line],
    single: Mapping[tuple[str, float], Sequence[Line]],
    settled: Mapping[tuple[str, float], float],
    floor_nm: float,
) -> Iterator[Verdict]:
    short, middle, long = HIGHEST
    for chain, whose in CHAINS.items():
        own = {length_s: lines[chain, length_s] for length_s in HIGHEST}
        yield _slope_ratio(f"doubled T_b nearly doubles the slope, 50 to 100 us ({whose})", own[middle], own[short])
        yield _slope_ratio(f"doubled T_b nearly doubles the slope, 100 to 200 us ({whose})", own[long], own[middle])
        offsets = [f"{line.intercept:.0f} +- {line.intercept_u:.0f}" for line in own.values()]
        yield Verdict(
            f"the lines have negative offsets: -75, -147, -222 nm in the paper ({whose})",
            f"{', '.join(offsets)} nm",
            all(line.intercept + 2 * line.intercept_u < 0 for line in own.values()),
        )
        yield Verdict(
            f"offset over slope as the paper's -0.18, -0.18, -0.13, within two standard errors ({whose})",
            ", ".join(
                f"{line.intercept / line.slope:.2f} +- {line.intercept_u / line.slope:.2f}" for line in own.values()
            ),
            all(
                abs(line.intercept / line.slope - PAPER_OFFSET_NM[length_s] / PAPER_SLOPE_NM[length_s])
                < 2 * line.intercept_u / line.slope
                for length_s, line in own.items()
            ),
        )
        yield Verdict(
            f"R^2 above 0.9 for every T_b, means of five ({whose})",
            ", ".join(f"{line.r_squared:.3f}" for line in own.values()),
            min(line.r_squared for line in own.values()) > 0.9,
        )
        spans = [[one.r_squared for one in single[chain, length_s]] for length_s in HIGHEST]
        yield Verdict(
            f"R^2 above 0.9 for every T_b, single measurements ({whose})",
            "; ".join(f"{min(span):.2f} to {max(span):.2f}" for span in spans),
            min(min(span) for span in spans) > 0.9,
        )
        plateau = [settled[chain, length_s] for length_s in HIGHEST]
        yield Verdict(
            f"points level off between 100 and 200 nm at every T_b ({whose})",
            f"points at F <= 0.04 settle at {', '.join(f'{nm:.0f}' for nm in plateau)} nm",
            all(100 < nm < 200 for nm in plateau),
        )
    yield Verdict(
        "a reliable measurement begins between 100 and 200 nm",
        f"detected from {floor_nm:.0f} nm by a trigger jitter of 1 ns and 40 dB",
        100 < floor_nm < 200,
    )


def _slope_ratio(statement: str, over: Line, under: Line) -> Verdict:
    ratio = over.slope / under.slope
    u = ratio * np.hypot(over.slope_u / over.slope, under.slope_u / under.slope)
    return Verdict(statement, f"{ratio:.2f} +- {u:.2f}", abs(ratio - 2) < 2 * u)
