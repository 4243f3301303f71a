"""Run the paper's experiments on the twin and write scripts/figures/beside-the-paper.md: all, or those named.

Usage: python scripts/beside_the_paper.py [EXPERIMENT ...]
"""

import argparse
from pathlib import Path

from hpe_rig.validation import (
    dose,
    figure_1,
    figure_14,
    figure_15,
    figure_16,
    figure_17,
    figure_18,
    figure_19,
    interference,
    table_2,
    write_page,
)

EXPERIMENTS = (figure_1, figure_14, figure_15, figure_16, figure_17, figure_18, figure_19, table_2, interference, dose)


def main() -> None:
    """Run every experiment (some minutes), print its verdicts, and write the page; with names, print those alone."""
    known = {run.__name__: run for run in EXPERIMENTS}
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("experiments", nargs="*", metavar="EXPERIMENT", help=f"one of {', '.join(known)}")
    names = parser.parse_args().experiments
    if wrong := [name for name in names if name not in known]:
        parser.error(f"no experiment is called {', '.join(wrong)}: try one of {', '.join(known)}")
    found = []
    for run in [known[name] for name in names] or EXPERIMENTS:
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
    main()
