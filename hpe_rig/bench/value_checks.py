"""Values of a bench file that a schema accepts, although no bench can mean them."""

from __future__ import annotations

from collections.abc import Iterator

from hpe_rig.bench.bench_file import NO_SERIAL, BenchFile
from hpe_rig.scene import Mistake

IDENTIFY = "hpe-rig bench BENCH --identify, which enters it"


def wrong_values(bench: BenchFile) -> Iterator[Mistake]:
    """Yield limits in the wrong order, serial numbers that no instrument has, and a calibration that ends too early."""
    yield from _reversed_bands(bench)
    yield from _impossible_serials(bench)
    if bench.digitizer.common_reference:
        what = f"the driver cannot lock an {bench.digitizer.model} to a 10 MHz reference"
        remedy = "no such key: common_reference of burst_train and tracking_train suffices"
        yield Mistake("digitizer.common_reference", what, remedy)
    calibration = bench.calibration
    if calibration is None or calibration.date is None or calibration.valid_until is None:
        return
    if calibration.valid_until < calibration.date:
        what = f"{calibration.valid_until} is before the measurement, calibration.date = {calibration.date}"
        yield Mistake("calibration.valid_until", what, "a day after the measurement, or the two exchanged")


def _reversed_bands(bench: BenchFile) -> Iterator[Mistake]:
    for role, generator in bench.generators.by_role.items():
        low_hz, high_hz = generator.carrier_band_hz or (0.0, 0.0)
        if low_hz > high_hz:
            what = f"the lower limit, {low_hz:g} Hz, is above the upper one, {high_hz:g} Hz"
            yield Mistake(f"generators.{role}.carrier_band_hz", what, "the two exchanged")


def _impossible_serials(bench: BenchFile) -> Iterator[Mistake]:
    serials = {f"generators.{role}": item.serial for role, item in bench.generators.by_role.items()}
    for table, serial in (serials | {"digitizer": bench.digitizer.serial}).items():
        if serial is not None and not serial.strip():
            yield Mistake(f"{table}.serial", "the serial number is empty", f"{IDENTIFY}, or no such key")
        elif serial is not None and serial != NO_SERIAL and serial.strip().lower() == NO_SERIAL:
            what = f'{serial!r} would be compared as a serial number; did you mean "{NO_SERIAL}"?'
            yield Mistake(f"{table}.serial", what, f'"{NO_SERIAL}", or {IDENTIFY}')
