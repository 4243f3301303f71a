"""Write docs/reference/command-tree.md: the commands of the simulated generators, their arguments and tested examples.

Usage: python docs/_build_tools/command_tree.py

The forms come from the twin's own table, the examples from tests/sim_backend/generator/command_examples.py, where a
test sends each of them to every model that knows the form.
"""

import argparse
import runpy
from pathlib import Path
from typing import Any

from sim_backend.generator import MODELS, tree_of

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "reference" / "command-tree.md"
EXAMPLES = ROOT / "tests" / "sim_backend" / "generator" / "command_examples.py"
HEAD = """\
# Commands that the simulated generators know

The instrument side of a bench in the twin, for any program: what can be sent, what is answered. Written by
`python docs/_build_tools/command_tree.py` from the table that the twin itself looks headers up in; a test holds it.

* A node in brackets may be left out. Every node has a long form and a short one, its capitals; case does not matter.
  `<n>` stands for the number of a channel, 1 or 2, on the 33500B and the 33600A alone.
* MIN, MAX and DEF may stand for a number, and MIN and MAX may follow a query. Prefixes of units are understood.
* *Tested by* is an exchange that `test_command_tree.py` has with every model that knows the form: what is sent, what is
  asked then, the reply, or the first error in the queue. Two more of its tests send every form in every spelling, and
  every reply back to where it came from.
* What the twin does not simulate is refused with -241 and says so: modulation, sweep, marker, arbitrary waveforms, the
  lock to an external reference. It puts out sine, square, pulse and DC; a ramp, a triangle or noise can be
  set, and switched on, but nothing of it reaches the transducer. Phases are kept and have no effect. The second channel
  has settings of its own, and no connector on any bench.
* On RS-232 an instrument that was never sent `SYST:REM` answers queries and refuses settings with 550.
* `*RCL` brings back an output that was on (assumed: no source says whether it does).
"""


def models_with(form: str) -> str:
    """Return which models know a form."""
    names = [name for name, model in MODELS.items() if form in tree_of(model)]
    return "all" if len(names) == len(MODELS) else ", ".join(names)


def row(form: str, example: Any) -> str:
    """Return the row of a form; its entry is that of the first model that knows it."""
    entry = next(tree[form] for tree in map(tree_of, MODELS.values()) if form in tree)
    takes = "–" if entry.command is None else entry.accepts or "nothing"
    query = "–" if entry.query is None else f"`?` {getattr(entry, 'query_accepts', '')}".strip()
    return f"| {' | '.join((f'`{form}`', takes, query, models_with(form), exchange(example)))} |"


def exchange(example: Any) -> str:
    """Return an example as one cell."""
    sent = [f"`{line}`" for line in example.message.splitlines()]
    asked = [f"`{example.query}`"] if example.query else []
    told = [f"`{example.reply}`"] if example.reply else []
    error = [f"error {example.error}"] if example.error else []
    return ", ".join([*sent, *asked, *told, *error])


def page() -> str:
    """Return the whole page."""
    lines = [HEAD]
    for title, group in runpy.run_path(str(EXAMPLES))["GROUPS"].items():
        lines += [f"## {title}\n", "| form | takes | query | models | tested by |", "|---|---|---|---|---|"]
        lines += [row(form, example) for form, example in group.items()]
        lines.append("")
    return "\n".join(lines).rstrip() + "\n"


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    PAGE.write_text(page(), encoding="utf-8")
    print(f"{PAGE.relative_to(ROOT)} written")
