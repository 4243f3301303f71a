"""Record of a commissioning in the bench file: measured delays, and the proven cables with the date."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import date
from importlib.metadata import version
from pathlib import Path
from typing import Any

from hpe_rig.bench import BenchText, parse_bench
from hpe_rig.measurement.commissioning import CableResult
from hpe_rig.scene import Mistake, SettingsError
from hpe_rig.store import replace_text


def with_commissioning(text: str, name: str, results: Sequence[CableResult], day: date) -> str:
    """Return the ``text`` of a bench file with the measured delays and the table [commissioning].

    Comments and order stay. If a cable has a fault, the text is returned without [commissioning].
    """
    import tomlkit

    document: Any = tomlkit.parse(text)
    document.pop("commissioning", None)
    if any(result.fault for result in results):
        return tomlkit.dumps(document)
    by_ends = {(result.source, result.target): result for result in results}
    for cable in document["wiring"]:
        result = by_ends[cable["source"], cable["target"]]
        # To 10 ps, a hundredth of the uncertainty.
        cable["delay_s"], cable["delay_u_s"] = round(result.delay_s, 11), round(result.delay_u_s, 11)
    bench = parse_bench(name, tomlkit.dumps(document)).bench
    table = tomlkit.table()
    table["date"], table["program"] = day, f"hpe-rig {version('hpe-rig')}"
    table["digest"] = bench.commissioned_digest
    table["cables"] = [f"{result.source} -> {result.target}" for result in results]
    document["commissioning"] = table
    return tomlkit.dumps(document)


def record_commissioning(path: Path, before: BenchText, results: Sequence[CableResult], day: date) -> None:
    """Write the results into the bench file ``path``, read as ``before``; other changes since then are kept.

    Raises ``SettingsError`` if its instruments or cables were changed during the commissioning.
    """
    # Line ends stay as they are, so the text is not read with universal newlines.
    text = path.read_bytes().decode("utf-8-sig")
    if parse_bench(path.stem, text).bench.commissioned_digest != before.bench.commissioned_digest:
        what = "its instruments or cables were changed during the commissioning, which is not recorded"
        raise SettingsError(f"bench {path.stem}", [Mistake("", what, "commission again")])
    replace_text(path, with_commissioning(text, path.stem, results, day))
