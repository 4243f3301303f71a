"""Command ``verify``: what a run or result file holds, and what of it is damaged, in words or as JSON."""

from __future__ import annotations

import json as json_format

import typer

from hpe_rig.store import Verification


def print_verification(found: Verification, json: bool = False) -> None:
    """Print what was found in a file."""
    if json:
        typer.echo(json_format.dumps(found.as_dict(), indent=2))
        return
    what = f"{found.shots_complete} of {found.shots} shots complete, {found.records} records, {found.status}"
    typer.echo(f"{found.path}: {what if found.kind == 'run' else f'results of {found.shots} shots'}")
    for damage in found.damage:
        typer.echo(f"DAMAGED: {damage}")
    typer.echo(_verdict(found))


def _verdict(found: Verification) -> str:
    if found.damage:
        remedy = "hpe-rig process" if found.kind == "result" else "hpe-rig resume, which measures damaged shots again"
        return f"what is damaged counts as missing and enters no result. Try: another copy of the file, or {remedy}."
    if not found.checksums:
        return "it holds no checksums, being of an earlier release: whether its values were changed cannot be told"
    return "sound: everything in it is as its checksums say"
