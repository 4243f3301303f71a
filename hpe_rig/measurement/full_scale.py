"""End of a run if its first shot is at full scale in every record: such records measure nothing."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import closing

import numpy as np

from drivers.interfaces import InstrumentError, RecordBlock
from hpe_rig.measurement.sequencer import Event, ShotBlock, ShotDone
from hpe_rig.plan import Shot


def end_at_full_scale(events: Generator[Event, None, None]) -> Generator[Event, None, None]:
    """Yield ``events``; raise ``InstrumentError`` if every record of the first shot reaches full scale in its gate.

    It is raised instead of the first ``ShotDone``, when outputs are off: the records are kept, and the shot counts as
    not measured.
    """
    is_first, records, all_at_full_scale = True, 0, True
    with closing(events):
        for event in events:
            if is_first and isinstance(event, ShotBlock) and all_at_full_scale:
                records += event.block.codes.shape[0]
                all_at_full_scale = _every_record_at_full_scale(event.shot, event.block)
            elif is_first and isinstance(event, ShotDone):
                if records and all_at_full_scale:
                    raise _too_large(event.shot, records)
                is_first = False
            yield event


def _every_record_at_full_scale(shot: Shot, block: RecordBlock) -> bool:
    """Return whether each record of ``block`` has a sample at full scale in the gate."""
    lowest, highest = block.code_limits
    # The rest of a record may hold the tracking pulse itself, which may saturate the input.
    gate = block.codes[:, shot.gate]
    return bool(np.all((gate.min(axis=1) <= lowest) | (gate.max(axis=1) >= highest)))


def _too_large(shot: Shot, records: int) -> InstrumentError:
    range_v = shot.capture.input_range_v
    return InstrumentError(
        "digitizer",
        f"all {records} records of shot {shot.index + 1} reach full scale (+-{range_v:g} V) in the gate",
        "the echo is larger than the range, a toneburst reaches the receiver, or generators are exchanged",
        "hpe-rig align, a larger acquisition.input_range_v or less gain, hpe-rig bench; then hpe-rig resume",
    )
