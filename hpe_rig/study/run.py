"""Run of a study from its name to its results: expand it, skip completed cases, compute the others, write."""

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

BATCH_SIZE = 24
"""Cases of a batch: enough to share draws and noise, few enough that the loss of a worker costs little."""

OnProgress = Callable[[int, int], None]
"""Receives the number of completed realisations and of all realisations."""


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

    ``output``/cases holds one file for each completed case, ``output``/NAME the results. Completed cases of any study
    are not computed again, except damaged ones, which ``tell`` reports. ``open_pool`` opens the workers, by
    default one for each processor of this machine. Raises ``SettingsError`` with every mistake before any computation,
    and ``TypeError`` for a wrong type.

    >>> (result,) = run_study("fig-7", "results")
    """
    if not isinstance(output, str | os.PathLike):
        raise TypeError(f"a study's output must be the path of a folder, not {type(output).__name__}")
    output = Path(output)
    open_pool = open_pool or partial(processes, os.cpu_count() or 1)
    studies = {
        study: (definition, points_of(study, definition, folder))
        for study, (definition, folder) in read_studies(name, replaced).items()
    }
    store = CaseStore(output / "cases")
    store.prepare()
    # Equal cases of several studies have one key.
    cases = {point.case.key: point.case for _, points in studies.values() for point in points}
    records = {key: record for key in cases if (record := store.read(key)) is not None}
    if damaged := sum(store.is_damaged(key) for key in cases if key not in records):
        tell(f"{damaged} case files in {store.folder} are damaged or have no checksum: computing them again")
    pending = [case for key, case in cases.items() if key not in records]
    try:
        _compute(pending, store, records, open_pool, ahead, watch)
    except BaseException as error:
        error.add_note(f"{len(records)} of {len(cases)} cases are stored in {output}: the same command continues")
        raise
    results = [result_of(study, definition, points, records) for study, (definition, points) in studies.items()]
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
    with closing(completed(open_pool, compute, batches(cases), ahead)) as finished_batches:
        for batch in finished_batches:
            for record in batch:
                store.write(record)
                records[record["case"]] = record
                done += size[record["case"]]
            watch(done, total)


def compute(cases: Sequence[AnyCase]) -> list[CaseRecord]:
    """Return one record for each case of a batch, in order; a batch never mixes the two kinds of cases."""
    measured = [case for case in cases if isinstance(case, MeasuredCase)]
    return [measure_case(case) for case in measured] or run_batch([c for c in cases if not isinstance(c, MeasuredCase)])


def batches(cases: Sequence[AnyCase]) -> list[list[AnyCase]]:
    """Return batches of cases with the same noise, sorted by echoes within, the longest batches first."""
    # Cases of one batch share noise; neighbours with the same echoes share those too.
    ordered = sorted(cases, key=lambda case: (case.batch_key, case.key))
    result = []
    for _, group in itertools.groupby(ordered, lambda case: case.batch_key[0]):
        members = list(group)
        result += [members[first : first + BATCH_SIZE] for first in range(0, len(members), BATCH_SIZE)]
    return sorted(result, key=lambda batch: -sum(case.cost for case in batch))
