"""Digest of the parts of a bench file that a commissioning proves: which box, which cable, which delay."""

from __future__ import annotations

import hashlib
import json

from hpe_rig.bench.bench_file import BenchFile

INSTRUMENT_KEYS = {"model", "address", "interface", "serial", "system_id", "board_id"}


def commissioned_digest(bench: BenchFile) -> str:
    """Return the digest of instruments and wiring, 16 hexadecimal digits."""
    instruments = {**bench.generators.by_role, "digitizer": bench.digitizer}
    proven = {
        "simulated": bench.simulated,
        "instruments": {
            role: item.model_dump(mode="json", include=INSTRUMENT_KEYS, exclude_none=True)
            for role, item in instruments.items()
        },
        "wiring": sorted([cable.source, cable.target, f"{cable.delay_s:.12g}"] for cable in bench.wiring),
    }
    return hashlib.sha256(json.dumps(proven, sort_keys=True).encode()).hexdigest()[:16]
