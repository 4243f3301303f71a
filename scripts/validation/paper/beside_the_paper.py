"""Run the paper's experiments on the twin and write scripts/figures/beside-the-paper.md.

With names of experiments, only these are run, and no page is written.

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
"""Experiments with random quantities, which are repeated for every seed."""


def verdicts_of_seeds(seeds: int, file: Path) -> dict[tuple[str, str], list[bool]]:
    """Return whether each statement is met with seeds 2 to ``seeds``; verdicts stored in ``file`` are used again."""
    lines = [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []
    done = {(seed, run) for seed, run, *_ in lines}
    # Seed by seed: Figs. 16 and 17 share one cached measurement.
    for seed in range(2, seeds + 1):
        for run in SEEDED:
            if (seed, run.__name__) in done:
                continue
            experiment = run(seed)
            new = [
                [seed, run.__name__, experiment.key, verdict.statement, bool(verdict.met)]
                for verdict in experiment.verdicts
            ]
            with file.open("a") as stream:
                stream.writelines(json.dumps(line) + "\n" for line in new)
            lines += new
    verdicts: dict[tuple[str, str], list[bool]] = {}
    for seed, _, key, statement, met in lines:
        if seed <= seeds:
            verdicts.setdefault((key, statement), []).append(met)
    return verdicts


def main() -> None:
    """Run the experiments (some minutes) and print their verdicts; write the page if no experiment is named."""
    runs = {run.__name__: run for run in EXPERIMENTS}
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("experiments", nargs="*", metavar="EXPERIMENT", help=f"one of {', '.join(runs)}")
    parser.add_argument("--seeds", type=int, default=1, help="number of draws of scatterers, noise and jitter")
    parser.add_argument(
        "--kept",
        type=Path,
        default=Path("beside-the-paper.jsonl"),
        help="file of the verdicts of seeds, read and extended",
    )
    arguments = parser.parse_args()
    if unknown := [name for name in arguments.experiments if name not in runs]:
        parser.error(f"no experiment is called {', '.join(unknown)}: try one of {', '.join(runs)}")
    experiments = []
    for run in [runs[name] for name in arguments.experiments] or EXPERIMENTS:
        experiment = run()
        experiments.append(experiment)
        print(f"{experiment.key}: {experiment.title}", flush=True)
        for row in experiment.table if arguments.experiments else ():
            print("  " + " | ".join(row))
        for verdict in experiment.verdicts:
            print(f"  {'met   ' if verdict.met else 'MISSED'} {verdict.statement}: {verdict.finding}")
    if not arguments.experiments:
        tally = verdicts_of_seeds(arguments.seeds, arguments.kept) if arguments.seeds > 1 else None
        print(write_page(experiments, Path(__file__).parents[2] / "figures", tally))


if __name__ == "__main__":
    main()
