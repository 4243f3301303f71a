"""Listing of a folder: what each run is, its strongest harmonic, search, and files that cannot be read."""

from __future__ import annotations

import os
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from hpe_rig.measurement import prepare_text, provenance_now, record_run
from hpe_rig.runs import process
from hpe_rig.scene import shipped_scenes
from hpe_rig.store import StoreError, WriteOptions, list_runs, listing, listing_schema, matching_runs, read_run
from hpe_rig.store.listing import RunEntry

STARTED = "2026-11-26T08:00:00+01:00"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a processed run of two frequencies, and a run of early date in a subfolder."""
    folder = tmp_path_factory.mktemp("runs")
    text = shipped_scenes()["table-1"].replace("pulse_count = 101", "pulse_count = 48")
    text = text.replace("[acquisition]", "[acquisition]\nrecord_samples = 256") + '\n[notes]\nbatch = "A7"\nlayer = 3\n'
    setup = prepare_text("small", text)
    provenance = replace(provenance_now(setup.bench.bench), started=STARTED, user="operator", host="rack")
    record_run(setup, folder / "run.h5", options=WriteOptions(provenance=provenance))
    process(folder / "run.h5")
    (folder / "below").mkdir()
    early = replace(provenance, started="2020-01-01T00:00:00+00:00")
    record_run(setup, folder / "below" / "early.h5", options=WriteOptions(provenance=early))
    return folder


def test_a_run_is_listed_with_its_facts_and_the_strongest_harmonic_of_its_result(folder: Path) -> None:
    (entry,), unreadable = list_runs(folder)
    assert unreadable == []
    assert (entry.path, entry.date, entry.status) == (folder / "run.h5", datetime.fromisoformat(STARTED), "complete")
    assert (entry.shots_complete, entry.shots, entry.shots_marked_bad) == (1, 1, 0)
    assert (entry.simulated, entry.imported, entry.user, entry.host) == (True, "", "operator", "rack")
    assert dict(entry.notes) == {"batch": "A7", "layer": 3}
    assert entry.lead is not None
    # Table I: 1000 nm at 200 Hz.
    assert entry.lead.frequency_hz == 200.0
    assert entry.lead.amplitude_m == pytest.approx(1e-6, rel=0.1)
    values = entry.as_dict()
    assert set(values) == set(listing_schema()["items"]["required"])
    assert (values["date"], values["file"]) == (entry.date.isoformat(), str(entry.path))
    assert values["lead"]["amplitude_m"] == entry.lead.amplitude_m
    assert replace(entry, conditions={"water C": float("nan")}).as_dict()["conditions"] == {"water C": None}
    assert replace(entry, lead=None).as_dict()["lead"] is None


def test_runs_of_subfolders_come_on_request_and_in_the_order_of_their_dates(folder: Path, tmp_path: Path) -> None:
    entries, _ = list_runs(folder, below=True)
    assert [entry.path.name for entry in entries] == ["early.h5", "run.h5"]
    with pytest.raises(StoreError, match=r"run\.h5 is no folder"):
        list_runs(folder / "run.h5")
    (tmp_path / "damaged.h5").write_bytes(b"no HDF5 file")
    entries, (message,) = list_runs(tmp_path)
    assert entries == []
    assert "damaged.h5" in message


def test_a_search_has_all_words_in_any_case_and_both_ends_of_its_time(folder: Path) -> None:
    entries, _ = list_runs(folder)
    date = entries[0].date
    second = timedelta(seconds=1)
    for words in ([], ["TABLE I"], ["simulated", "a7"], ["layer: 3"], ["operator", "RACK", "run.h5", "complete"]):
        assert matching_runs(entries, words) == entries
    for words in (["measured"], ["simulated", "b7"], ["imported"]):
        assert matching_runs(entries, words) == []
    assert matching_runs(entries, [], since=date, until=date) == entries
    assert matching_runs(entries, [], since=date + second) == []
    assert matching_runs(entries, [], until=date - second) == []
    measured = replace(entries[0], simulated=False)
    imported = replace(measured, imported="a.npy")
    assert [matching_runs([entry], [word]) != [] for entry, word in ((measured, "measured"), (imported, "a.npy"))] == [
        True,
        True,
    ]
    assert matching_runs([imported], ["measured"]) == []


def test_a_result_from_before_a_mark_is_not_shown(folder: Path) -> None:
    stored = read_run(folder / "run.h5")
    marks = stored.mark([0], "the pump")
    try:
        (entry,), _ = list_runs(folder)
        assert (entry.lead, entry.shots_marked_bad) == (None, 1)
    finally:
        marks.unlink()
    (entry,), _ = list_runs(folder)
    assert entry.lead is not None


def test_the_latest_result_counts_and_one_that_cannot_be_read_is_named(folder: Path) -> None:
    latest = folder / "run.later.h5"
    (result,) = [path for path in folder.glob("run.*.h5") if path != latest]
    content = bytearray(result.read_bytes())
    content[content.find(b'"amplitude_m"') + 20] ^= 1
    latest.write_bytes(content)
    try:
        earlier_s = result.stat().st_mtime
        os.utime(latest, (earlier_s + 10, earlier_s + 10))
        entries, messages = list_runs(folder)
        assert entries == []
        assert "run.later.h5" in messages[0]
        os.utime(latest, (earlier_s - 10, earlier_s - 10))
        assert list_runs(folder)[1] == []
    finally:
        latest.unlink()


def test_conditions_are_means_of_finite_readings_and_a_run_without_a_start_has_the_date_of_its_file(
    folder: Path,
) -> None:
    stored = read_run(folder / "run.h5")
    tables = {"conditions": [{"name": "water", "unit": "C"}, {"name": "level"}, 3]}
    readings = {"water": np.array([20.0, np.nan, 21.0]), "level": np.array([1.0]), "flow": np.array([np.nan])}
    means = listing._mean_conditions(replace(stored, conditions=readings), tables)
    assert means == {"water C": 20.5, "level": 1.0}
    assert listing._mean_conditions(stored, {}) == {}
    undated = replace(stored, provenance=replace(stored.provenance, started=""))
    assert listing._date(undated).timestamp() == pytest.approx(stored.path.stat().st_mtime, abs=1e-3)
    assert isinstance(listing._entry(undated), RunEntry)
    assert listing._source({"recording": {"source": "a.npy"}}) == "a.npy"
    assert listing._source({"recording": 3}) == ""


def test_the_strongest_harmonic_is_of_the_means_else_of_the_shots_with_earlier_names(folder: Path) -> None:
    def estimate(frequency_hz: float, amplitude_m: float | None, corrected_m: float | None = None) -> dict[str, object]:
        values = {"amplitude_m": amplitude_m, "amplitude_uncertainty_m": 1e-9, "phase_rad": 0.1}
        values |= {"frequency_hz": frequency_hz, "phase_uncertainty_rad": 0.2, "corrected_amplitude_m": corrected_m}
        names = "corrected_uncertainty_m", "corrected_phase_rad", "corrected_phase_uncertainty_rad"
        return values | dict.fromkeys(names, 0.5)

    shots = [{"estimates": [estimate(100.0, 1e-6), estimate(200.0, None)]}]
    result = {"estimator": "kasai", "shots": shots}
    first, second = listing._harmonics(result, False)
    assert (first.estimator, first.frequency_hz, first.amplitude_m, first.phase_rad) == ("kasai", 100.0, 1e-6, 0.1)
    assert np.isnan(second.amplitude_m)
    clipped = {"untrusted": "every record reaches full scale", "estimates": [estimate(100.0, 9e-6)]}
    incomplete = {"complete": False, "estimates": [estimate(100.0, 9e-6)]}
    trusted = listing._harmonics(result | {"shots": [clipped, incomplete, *shots]}, False)
    assert [item.frequency_hz for item in trusted] == [100, 200]
    (only,) = listing._harmonics(result | {"shots": [clipped, incomplete]}, False)
    assert only.amplitude_m == 9e-6
    (mean,) = listing._harmonics(result | {"means": [estimate(300.0, 2e-6)]}, False)
    assert mean.frequency_hz == 300.0
    early = result | {"shots": [{"estimates": [estimate(100.0, 1e-6, 3e-6), estimate(200.0, 1e-6)]}]}
    assert [(item.amplitude_m, item.phase_rad) for item in listing._harmonics(early, True)] == [
        (3e-6, 0.5),
        (1e-6, 0.1),
    ]
    assert [item.amplitude_m for item in listing._harmonics(early, False)] == [1e-6, 1e-6]
