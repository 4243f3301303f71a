"""Datasets of a run file that are written during a run: type, axes, unit and kind of checksum, in one table.

``layout.py`` creates the datasets, the writer encodes rows by them, and a reader refuses a file that differs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from hpe_rig.store.format import SNAPSHOT_BYTES, TIME_BYTES, UNTRUSTED_BYTES

RECORD_AXES: Final = ("shot", "pulse", "sample")
TRUE_HARMONICS: Final = ("true_harmonics/in_phase_m", "true_harmonics/quadrature_m")
"""A cos(phase) and A sin(phase) of the true displacement at the focus."""


@dataclass(frozen=True, slots=True)
class Layout:
    """Type of a dataset, names of its axes, and unit of its values."""

    dtype: str
    axes: tuple[str, ...]
    unit: str = "1"


_BY_PULSE: Final = RECORD_AXES[:2]
DATASETS: Final = {
    # Settings of the instruments as JSON; why a shot cannot be relied on; differences of the settings after a shot.
    "snapshot": Layout(f"S{SNAPSHOT_BYTES}", ("shot",)),
    "untrusted": Layout(f"S{UNTRUSTED_BYTES}", ("shot",)),
    "changed_settings": Layout(f"S{UNTRUSTED_BYTES}", ("shot",)),
    "conditions/before": Layout("<f8", ("shot", "condition")),
    "conditions/after": Layout("<f8", ("shot", "condition")),
    "records/echo": Layout("<i2", RECORD_AXES, "V"),
    "records/monitor": Layout("<i2", RECORD_AXES, "V"),
    "records/recorded": Layout("u1", _BY_PULSE),
    "records/trigger_time_s": Layout("<f8", _BY_PULSE, "s"),
    "records/pulse_onset_s": Layout("<f8", _BY_PULSE, "s"),
    "records/shot_complete": Layout("u1", ("shot",)),
    "records/clipped": Layout("u1", ("shot",)),
    # Relative force that the toneburst generator was set to, as read back.
    "records/force_set": Layout("<f8", ("shot",)),
    "truth/displacement_m": Layout("<f8", _BY_PULSE, "m"),
    **dict.fromkeys(TRUE_HARMONICS, Layout("<f8", ("shot", "frequency"), "m")),
    "run_time/run_time_s": Layout("<f8", ("stage",), "s"),
    "provenance/ended": Layout(f"S{TIME_BYTES}", ()),
}
BY_CHUNK: Final = ("records/echo", "records/monitor", "records/recorded")
"""Datasets with a checksum for each shot and chunk of echoes; the one of ``recorded`` covers the trigger times too."""
AT_ONCE: Final = tuple(name for name, layout in DATASETS.items() if layout.axes[:1] != ("shot",))
"""Datasets with one checksum, which are always written completely."""
BY_SHOT: Final = tuple(name for name in DATASETS if name not in (*BY_CHUNK, *AT_ONCE, "records/trigger_time_s"))
"""Datasets with a checksum for each shot."""
