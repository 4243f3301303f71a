"""Command ``bench --identify``: a person says which instrument shows which role; serial numbers are written."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import typer

from hpe_rig.bench import BenchFile, displayed_roles, lasting_serial, read_bench, with_serials
from hpe_rig.cli.console import EXIT_INSTRUMENT, announce
from hpe_rig.cli.terminal import answer, has_terminal
from hpe_rig.scene import Mistake, SettingsError
from hpe_rig.store import refuse_unwritable, replace_text


def identify(path: Path | None) -> int:
    """Write the serial number of each instrument into the bench file ``path``, as a person at the bench answers.

    Returns the exit code: 0 if every instrument answered and has the role of its address.
    """
    if path is None or path.suffix == ".h5":
        remedy = "hpe-rig new my-bench --like bench, then hpe-rig bench my-bench.toml --identify"
        raise SettingsError("--identify", [Mistake("", "it writes into a bench file, and none is named", remedy)])
    if not has_terminal():
        what = "somebody must look at the instruments and answer, and this is no terminal"
        raise SettingsError("--identify", [Mistake("", what, "the same command in a terminal at the bench")])
    bench = read_bench(path, lenient=True).bench
    refuse_unwritable(path)
    with displayed_roles(bench) as instruments:
        failures = {role: item for role, item in instruments.items() if isinstance(item, Exception)}
        for error in failures.values():
            announce(str(error))
        present = {role: item for role, item in instruments.items() if not isinstance(item, Exception)}
        shown_as = _ask_roles(bench, [role for role in present if role != "digitizer"])
        serials = {role: lasting_serial(present[shown]) for role, shown in shown_as.items()}
        if "digitizer" in present:
            serials["digitizer"] = lasting_serial(present["digitizer"])
    replace_text(path, with_serials(path, serials))
    return EXIT_INSTRUMENT if _print_outcome(path, bench, serials, shown_as) or failures else 0


def _print_outcome(path: Path, bench: BenchFile, serials: Mapping[str, str], shown_as: Mapping[str, str]) -> bool:
    """Print serial numbers and wrong generators; return whether one is exchanged or not identified."""
    for role, serial in serials.items():
        typer.echo(f"{role}: serial {serial}")
    typer.echo(f"{path} states {len(serials)} serial numbers; displays cleared, outputs off, verified")
    exchanged = {role: shown for role, shown in shown_as.items() if role != shown}
    for role, shown in exchanged.items():
        typer.echo(f"{role}: the instrument answers at the address of {shown}, {bench.address_text(shown)}")
    if exchanged:
        typer.echo("exchange these addresses in the bench file; it is refused until then")
    unknown = [role for role in bench.generators.by_role if role not in shown_as]
    if unknown:
        typer.echo(f"not identified: {', '.join(unknown)}")
    return bool(exchanged or unknown)


def _ask_roles(bench: BenchFile, shown: list[str]) -> dict[str, str]:
    """Return by role the role that its instrument shows; an instrument that has none of the roles is left out."""
    roles = list(bench.generators.by_role)
    shown_as: dict[str, str] = {}
    for role in shown:
        text = role.replace("_", " ").upper()
        question = f"One display shows {text}. Is that the instrument {_cables_text(bench, role)}?"
        while True:
            reply = answer(f"{question} [y, n, or the name of its role]: ").replace(" ", "_")
            actual = role if reply in ("y", "yes") else reply
            if actual in ("n", "no"):
                break
            if actual in roles and actual not in shown_as:
                shown_as[actual] = role
                break
            announce(f"{actual} was named before" if actual in shown_as else f"y, n, or one of {', '.join(roles)}")
    return shown_as


def _cables_text(bench: BenchFile, role: str) -> str:
    """Return in words the cables at the instrument of ``role``."""
    triggers = [cable.source for cable in bench.wiring if cable.target == f"{role}.trigger"]
    targets = [cable.target for cable in bench.wiring if cable.source == f"{role}.output"]
    cables = [f"with {' and '.join(triggers)} at its trigger input"] if triggers else ["without a trigger cable"]
    return ", ".join([*cables, f"its output to {' and '.join(targets)}"] if targets else cables)
