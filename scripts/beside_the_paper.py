"""Run the paper's experiments on the twin and write scripts/figures/beside-the-paper.md: all, or those named."""

import sys
from pathlib import Path

from hpe_rig.validation import (
    dose,
    figure_1,
    figure_14,
    figure_15,
    figure_18,
    figure_19,
    figures_16_17,
    interference,
    table_2,
    write_page,
)

EXPERIMENTS = (figure_1, figure_14, figure_15, figures_16_17, figure_18, figure_19, table_2, interference, dose)


def main(*names: str) -> None:
    """Run every experiment (some minutes), print its verdicts, and write the page; with names, print those alone."""
    chosen = [run for run in EXPERIMENTS if not names or run.__name__ in names]
    if len(chosen) < len(names):
        raise SystemExit(f"experiments are {', '.join(run.__name__ for run in EXPERIMENTS)}")
    found = []
    for run in chosen:
        experiment = run()
        found.append(experiment)
        print(f"{experiment.key}: {experiment.title}")
        for row in experiment.table if names else ():
            print("  " + " | ".join(row))
        for verdict in experiment.verdicts:
            print(f"  {'met   ' if verdict.met else 'MISSED'} {verdict.statement}: {verdict.found}")
    if not names:
        print(write_page(found, Path(__file__).parent / "figures"))


if __name__ == "__main__":
    main(*sys.argv[1:])
