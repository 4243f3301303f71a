"""Run the paper's experiments on the twin and write scripts/figures/beside-the-paper.md: all, or those named.

Usage: python scripts/validation/paper/beside_the_paper.py [EXPERIMENT ...] [--seeds N] [--kept FILE]
"""

import argparse
import json
from pathlib import Path

from experiments import write_page
from force_lines import figure_15
from muscle import figure_16, figure_17, figure_18, figure_19, table_2
from sphere import steel_sphere
from twin import dose, figure_1, figure_14, interference

EXPERIMENTS = (
    figure_1,
    figure_14,
    figure_15,
    figure_16,
    figure_17,
    figure_18,
    figure_19,
    table_2,
    steel_sphere,
    interference,
    dose,
)

SEEDED = (figure_14, figure_15, figure_16, figure_17, figure_18, figure_19, steel_sphere)
"""What is drawn anew with every seed."""


def other_seeds(seeds: int, kept: Path) -> dict[tuple[str, str], list[bool]]:
    """Return whether each statement is met with seeds 2 to ``seeds``; what ``kept`` holds is not run again."""
    lines = [json.loads(line) for line in kept.read_text().splitlines()] if kept.exists() else []
    done = {(seed, run) for seed, run, *_ in lines}
    # Seed by seed: what is measured once for two figures is kept until the next one.
    for seed in range(2, seeds + 1):
        for run in SEEDED:
            if (seed, run.__name__) in done:
                continue
            found = run(seed)
            new = [[seed, run.__name__, found.key, each.statement, bool(each.met)] for each in found.verdicts]
            with kept.open("a") as file:
                file.writelines(json.dumps(line) + "\n" for line in new)
            lines += new
    out: dict[tuple[str, str], list[bool]] = {}
    for seed, _, key, statement, met in lines:
        if seed <= seeds:
            out.setdefault((key, statement), []).append(met)
    return out


def main() -> None:
    """Run every experiment (some minutes), print its verdicts, and write the page; with names, print those alone."""
    known = {run.__name__: run for run in EXPERIMENTS}
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("experiments", nargs="*", metavar="EXPERIMENT", help=f"one of {', '.join(known)}")
    parser.add_argument("--seeds", type=int, default=1, help="draw scatterers, noise and jitter so many times")
    parser.add_argument(
        "--kept", type=Path, default=Path("beside-the-paper.jsonl"), help="verdicts of seeds run before"
    )
    given = parser.parse_args()
    if wrong := [name for name in given.experiments if name not in known]:
        parser.error(f"no experiment is called {', '.join(wrong)}: try one of {', '.join(known)}")
    found = []
    for run in [known[name] for name in given.experiments] or EXPERIMENTS:
        experiment = run()
        found.append(experiment)
        print(f"{experiment.key}: {experiment.title}", flush=True)
        for row in experiment.table if given.experiments else ():
            print("  " + " | ".join(row))
        for verdict in experiment.verdicts:
            print(f"  {'met   ' if verdict.met else 'MISSED'} {verdict.statement}: {verdict.found}")
    if not given.experiments:
        others = other_seeds(given.seeds, given.kept) if given.seeds > 1 else None
        print(write_page(found, Path(__file__).parents[2] / "figures", others))


if __name__ == "__main__":
    main()
