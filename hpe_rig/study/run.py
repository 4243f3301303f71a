"""Run of a study from its name to its results: expand, leave out what is finished, compute the rest, write."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

from hpe_rig.study.cases import AnyCase, points_of
from hpe_rig.study.definition import read_studies
from hpe_rig.study.engine import run_batch
from hpe_rig.study.executor import OpenPool, completed, processes
from hpe_rig.study.measured import measure_case
from hpe_rig.study.measured_case import MeasuredCase
from hpe_rig.study.results import CaseRecord, CaseStore, StudyResult, result_of, write_study

MOST_CASES = 24
"""Cases of a batch: enough to share draws and noise, few enough that a lost worker costs little."""

OnProgress = Callable[[int, int], None]
"""Told the realisations done and to do."""


def run_study(
    name: str | os.PathLike[str],
    output: str | os.PathLike[str],
    open_pool: OpenPool | None = None,
    ahead: int = 0,
    replaced: Mapping[str, Any] | None = None,
    watch: OnProgress = lambda done, total: None,
    tell: Callable[[str], None] = lambda text: None,
) -> list[StudyResult]:
    """Run a study or a collection, write it below ``output`` and return its results.

    ``output``/cases holds a file a finished case, ``output``/NAME the results; cases finished before, by whichever
    study, are not computed again unless their files are damaged, of which ``tell`` is told.
    ``open_pool`` opens the workers, one a processor of this machine by default. Raises
    ``SettingsError`` with every mistake before anything is computed, and ``TypeError`` for a wrong type.

    >>> (result,) = run_study("fig-7", "results")
    """
    if not isinstance(output, str | os.PathLike):
        raise TypeError(f"a study's output is taken as the path of a folder, not as {type(output).__name__}")
    output = Path(output)
    open_pool = open_pool or partial(processes, os.cpu_count() or 1)
    studies = {
        own: (definition, points_of(own, definition, folder))
        for own, (definition, folder) in read_studies(name, replaced).items()
    }
    store = CaseStore(output / "cases")
    store.prepare()
    cases = {point.case.key: point.case for _, points in studies.values() for point in points}
    records = {key: record for key in cases if (record := store.read(key)) is not None}
    if damaged := sum(store.is_damaged(key) for key in cases if key not in records):
        tell(f"{damaged} case files in {store.folder} are damaged or older than their hashes: computed again")
    try:
        _compute([case for key, case in cases.items() if key not in records], store, records, open_pool, ahead, watch)
    except BaseException as error:
        error.add_note(f"{len(records)} of {len(cases)} cases are kept in {output}: the same command continues")
        raise
    results = [result_of(own, definition, points, records) for own, (definition, points) in studies.items()]
    for result in results:
        write_study(result, output / result.name)
    return results


def _compute(
    cases: Sequence[AnyCase],
    store: CaseStore,
    records: dict[str, CaseRecord],
    open_pool: OpenPool,
    ahead: int,
    watch: OnProgress,
) -> None:
    size = {case.key: case.scatterers * case.noise for case in cases}
    done, total = 0, sum(size.values())
    watch(done, total)
    ahead = ahead or 2 * (os.cpu_count() or 1) + 2
    with closing(completed(open_pool, compute, batches(cases), ahead)) as finished:
        for batch in finished:
            for record in batch:
                store.write(record)
                records[record["case"]] = record
                done += size[record["case"]]
            watch(done, total)


def compute(cases: Sequence[AnyCase]) -> list[CaseRecord]:
    """Return one record a case of a batch, in their order."""
    # Of a definition all cases are of one kind, and no batch holds those of two.
    measured = [case for case in cases if isinstance(case, MeasuredCase)]
    return [measure_case(case) for case in measured] or run_batch([c for c in cases if not isinstance(c, MeasuredCase)])


def batches(cases: Sequence[AnyCase]) -> list[list[AnyCase]]:
    """Return cases that share noise together, those that share echoes side by side, longest batches first."""
    ordered = sorted(cases, key=lambda case: (case.sharing, case.key))
    out = []
    for _, group in itertools.groupby(ordered, lambda case: case.sharing[0]):
        own = list(group)
        out += [own[first : first + MOST_CASES] for first in range(0, len(own), MOST_CASES)]
    return sorted(out, key=lambda batch: -sum(case.cost for case in batch))
