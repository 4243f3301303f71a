"""Page of the commands of the simulated generators, their arguments and tested examples.

The commands come from the table of the twin. The examples come from tests/sim_backend/generator/command_examples.py;
a test sends each of them to every model that has the command.
"""

import runpy
from pathlib import Path
from typing import Any

from sim_backend.generator import MODELS, tree_of

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "tests" / "sim_backend" / "generator" / "command_examples.py"
HEAD = """\
# Commands of the simulated generators

The commands of the simulated generators with their arguments and queries, for programs other than hpe_rig.

* **Spelling.** A node in brackets may be omitted. Every node has a long form and a short one, its capitals; case does
  not matter. `<n>` is the number of a channel, 1 or 2, on the 33500B and the 33600A only.
* **Numbers.** MIN, MAX and DEF can replace a number, and MIN and MAX can follow a query. Unit prefixes are accepted.
* **Tests.** *Tested by* is an exchange in `test_command_tree.py` with every model that has the command: the message
  sent, the query, and the reply or the first error in the queue. Two more tests send every command in every
  spelling, and send every reply back as an argument.
* **Not simulated.** Modulation, sweep, marker, arbitrary waveforms, stored states and the trigger timer are refused
  with -241; switching one off is accepted. The outputs are sine, square, pulse and DC. Ramp, triangle, noise and gated
  bursts can be set and switched on, but they do not reach the transducer. Phases are stored without effect. The second
  channel has settings but no connector on any bench.
* **RS-232.** An instrument that was never sent `SYST:REM` answers queries and refuses settings with 550.
"""


def models_with(form: str) -> str:
    """Return the models that have a command."""
    names = [name for name, model in MODELS.items() if form in tree_of(model)]
    return "all" if len(names) == len(MODELS) else ", ".join(names)


def row(form: str, example: Any) -> str:
    """Return the row of a command, from the entry of the first model that has it."""
    entry = next(tree[form] for tree in map(tree_of, MODELS.values()) if form in tree)
    arguments = "–" if entry.command is None else entry.accepts or "none"
    query = "–" if entry.query is None else f"`?` {getattr(entry, 'query_accepts', '')}".strip()
    return f"| {' | '.join((f'`{form}`', arguments, query, models_with(form), exchange(example)))} |"


def exchange(example: Any) -> str:
    """Return an example as one cell: messages, query, reply, error."""
    messages = [f"`{line}`" for line in example.message.splitlines()]
    query_and_reply = [f"`{text}`" for text in (example.query, example.reply) if text]
    error = [f"error {example.error}"] if example.error else []
    return ", ".join([*messages, *query_and_reply, *error])


def page() -> str:
    """Return the whole page."""
    lines = [HEAD]
    for title, group in runpy.run_path(str(EXAMPLES))["GROUPS"].items():
        lines += [f"## {title}\n", "| command | arguments | query | models | tested by |", "|---|---|---|---|---|"]
        lines += [row(form, example) for form, example in group.items()]
        lines.append("")
    return "\n".join(lines).rstrip() + "\n"
