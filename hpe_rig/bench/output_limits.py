"""Limits of the outputs that drive a transducer, compared with the settings that the instruments report.

A burst of n cycles at carrier f_c, triggered at f_t, has length n / f_c and duty n f_t / f_c. Number, length and
amplitude of the bursts together bound the energy of a train.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

from drivers.interfaces import InstrumentError, Setting
from hpe_rig.bench.bench_file import BenchFile

ROUNDING: Final = 1e-6
"""Relative excess over a limit that counts as rounding of an instrument's setting."""
TRANSDUCERS: Final = ("transducer.drive", "tracking_transducer.drive")


@dataclass(frozen=True, slots=True)
class Drive:
    """Bursts of the generator ``role`` at a transducer; ``bursts`` is their number in a train, 0 if not limited."""

    role: str
    carrier_hz: float
    cycles: float
    amplitude_vpp: float
    trigger_rate_hz: float
    bursts: float = 0

    @property
    def duty(self) -> float:
        """Fraction of the time during which the output is on."""
        return self.cycles / self.carrier_hz * self.trigger_rate_hz


def require_within_limits(bench: BenchFile, settings: Mapping[str, Mapping[str, Setting]]) -> None:
    """Raise ``InstrumentError`` with every limit of ``bench`` that ``settings``, read back by role, exceed."""
    mistakes = list(setting_mistakes(bench, settings))
    if mistakes:
        why = "the settings that the instruments report would drive the transducer beyond the bench's limits"
        remedy = "other values in scene or bench file; no output was enabled"
        raise InstrumentError("bench", "; ".join(mistakes), why, remedy)


def setting_mistakes(bench: BenchFile, settings: Mapping[str, Mapping[str, Setting]]) -> Iterator[str]:
    """Yield, in words, every limit that the outputs on a cable to a transducer exceed; ``settings`` are by role."""
    for cable in bench.wiring:
        role = cable.source.removesuffix(".output")
        if cable.target not in TRANSDUCERS or role not in settings:
            continue
        output = settings[role]
        if not output["burst_on"] or output["burst_mode"] != "TRIG" or output["trigger_source"] != "EXT":
            yield f"{role}: its output reads back as no counted burst on an external trigger"
            continue
        trigger = settings.get(_trigger_of(bench, role), {})
        drive = Drive(
            role,
            carrier_hz=float(output["frequency_hz"]),
            cycles=float(output["cycles"]),
            amplitude_vpp=float(output["amplitude_vpp"]),
            trigger_rate_hz=float(trigger.get("frequency_hz", 0.0)),
            bursts=float(trigger.get("cycles", 0)) if role == "toneburst" else 0,
        )
        yield from (text for _, text in drive_mistakes(bench, drive))


def drive_mistakes(bench: BenchFile, drive: Drive) -> Iterator[tuple[str, str]]:
    """Yield the key and, in words, the excess of every limit of ``bench`` that ``drive`` exceeds."""
    limits, generator = bench.limits, bench.generators.by_role[drive.role]
    burst = f"{drive.cycles:g} cycles of {drive.carrier_hz / 1e6:g} MHz"
    max_vpp = min(limits.max_drive_vpp or math.inf, generator.max_vpp or math.inf)
    for words, value, key, limit in (
        (f"duty of {burst} at {drive.trigger_rate_hz:g} Hz", drive.duty, "max_duty", limits.max_duty),
        (f"length of {burst}, s,", drive.cycles / drive.carrier_hz, "max_burst_length_s", limits.max_burst_length_s),
        ("number of bursts in a train", drive.bursts, "max_bursts", limits.max_bursts),
        ("amplitude, Vpp,", drive.amplitude_vpp, "max_drive_vpp or max_vpp", max_vpp),
    ):
        # Written so that NaN counts as an excess.
        if not value <= limit * (1 + ROUNDING):
            yield key, f"{drive.role}: {words} is {value:.4g}, {key} = {limit:.4g}"
    low_hz, high_hz = generator.carrier_band_hz or (0.0, math.inf)
    if not low_hz * (1 - ROUNDING) <= drive.carrier_hz <= high_hz * (1 + ROUNDING):
        band = f"{low_hz / 1e6:g} to {high_hz / 1e6:g} MHz"
        yield "carrier_band_hz", f"{drive.role}: carrier is {drive.carrier_hz / 1e6:g} MHz, carrier_band_hz {band}"


def _trigger_of(bench: BenchFile, role: str) -> str:
    """Return the generator that triggers ``role``, through the digitizer if that is between them."""
    sources: dict[str, str] = {cable.target: cable.source for cable in bench.wiring}
    source = sources.get(f"{role}.trigger", "")
    if source == "digitizer.aux":
        source = sources.get("digitizer.trigger", "")
    return source.removesuffix(".output")
