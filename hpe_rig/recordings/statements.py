"""Statements on a recording: who says what of it, and in which order they count.

An option or sidecar, the file itself, the scene. What neither of the first two said is an inference, and said in words;
what is needed and nobody states, or contradicts itself, is a mistake. Both are gathered as they are found.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.recordings.contents import Contents
from hpe_rig.recordings.settings import RecordingSettings
from hpe_rig.scene import Mistake, mistakes_of

REGULAR = 1e-3
"""Deviation from a fixed rate, in pulse periods, up to which times are those of a fixed rate."""


@dataclass(frozen=True, slots=True)
class Known:
    """What the scene says already: numbers of pulses and samples, rates; None or absent where it is silent."""

    pulse_count: int | None = None
    record_samples: int | None = None
    values: Mapping[str, float] = field(default_factory=dict)


@dataclass(slots=True)
class Statements:
    """What is said of one recording; ``mistakes`` and ``inferred`` grow as it is asked for."""

    settings: RecordingSettings
    contents: Contents
    known: Known
    where: Mapping[str, str]
    """Who states each of ``settings``."""
    mistakes: list[Mistake] = field(default_factory=list)
    inferred: list[str] = field(default_factory=list)

    def wrong(self, key: str, what: str, remedy: str) -> None:
        """Add a mistake of ``key``."""
        self.mistakes.append(Mistake(key, what, remedy))

    def stated(self, key: str) -> tuple[Any, str] | None:
        """Return what options, sidecar or file say of ``key``, and which of them."""
        own = getattr(self.settings, key, None)
        if own is not None:
            return own, self.where.get(key, "an option")
        return self.contents.stated.get(key)

    def number(self, key: str, needed: bool = True) -> float | None:
        """Return the value of ``key``; where nobody states it and it is ``needed`` that is a mistake."""
        own = getattr(self.settings, key, None)
        of_file = self.contents.stated.get(key)
        if own is not None:
            if of_file is not None and not np.isclose(float(of_file[0]), own, rtol=1e-6):
                self.inferred.append(
                    f"{key} = {own:g} as {self.where.get(key, 'an option')} says, the file says {of_file[0]:g}"
                )
            return float(own)
        if of_file is not None:
            value = float(of_file[0])
            check = self._within(key, value)
            if check is not None:
                self.wrong(key, f"{of_file[1]!r} of the file says {value:g}, {check.what}", f"{key} with the right one")
                return None
            self.inferred.append(f"{key} = {value:g}, by {of_file[1]!r} of the file")
            return value
        if key in self.known.values:
            value = self.known.values[key]
            self.inferred.append(f"{key} = {value:g}, by the scene")
            return value
        if needed:
            self.wrong(key, "neither options, sidecar, file nor scene state it", f"--set {key}=... or a sidecar file")
        return None

    @staticmethod
    def _within(key: str, value: float) -> Mistake | None:
        found = mistakes_of(RecordingSettings, {key: value})
        return found[0] if found else None

    def times(self, count: int | None) -> tuple[FloatArray | None, float | None, bool]:
        """Return the times of the pulses, their rate and whether it is regular."""
        stated = self.stated("pulse_time_s")
        if stated is None or (self.settings.pulse_time_s is None and self.settings.pulse_rate_hz is not None):
            rate_hz = self.number("pulse_rate_hz")
            first_s = self.settings.first_pulse_s
            if first_s is None:
                first_s = self.known.values.get("first_pulse_s", 0.0)
                said = "by the scene's tracking.delay_s" if "first_pulse_s" in self.known.values else "as nobody says"
                self.inferred.append(f"the first pulse is fired at {first_s:g} s, {said}: phases count from there")
            if rate_hz is None or count is None:
                return None, rate_hz, True
            return first_s + np.arange(count) / rate_hz, rate_hz, True
        times, origin = stated
        time_s = np.array(times, dtype=np.float64)
        if count is not None and time_s.size != count:
            self.wrong("pulse_time_s", f"{time_s.size} times ({origin}) for {count} pulses", "one time a pulse")
            return None, None, True
        if not np.isfinite(time_s).all() or not np.all(np.diff(time_s) > 0):
            where = int(np.argmax(~(np.diff(time_s) > 0))) + 1
            what = f"times ({origin}) do not ascend: pulse {where + 1} comes at {time_s[where]:g} s after "
            what += f"{time_s[where - 1]:g} s"
            self.wrong("pulse_time_s", what, "the times of the pulses in their order, s")
            return None, None, True
        if time_s[0] < 0 or time_s[-1] > 1e3:
            what = f"times ({origin}) run from {time_s[0]:g} to {time_s[-1]:g} s"
            self.wrong("pulse_time_s", what, "seconds from 0 on")
            return None, None, True
        fitted_hz = (time_s.size - 1) / (time_s[-1] - time_s[0])
        even = time_s[0] + np.arange(time_s.size) / fitted_hz
        regular = bool(np.abs(time_s - even).max() * fitted_hz < REGULAR)
        rate_hz = float(fitted_hz if regular else 1 / np.median(np.diff(time_s)))
        kind = "even to 0.1 %" if regular else "not even: each is taken as it is"
        if self.settings.pulse_time_s is None:
            self.inferred.append(f"pulses: {time_s.size} times by {origin!r} of the file")
        self.inferred.append(f"pulse_rate_hz = {rate_hz:.6g}, from {time_s.size} times, {kind}")
        return time_s, rate_hz, regular

    def first_sample_s(self, speed: float | None) -> float:
        """Return when the first sample of a record is taken after the onset of its pulse."""
        depth_m = self.settings.first_sample_depth_m
        if depth_m is None:
            if self.settings.first_sample_s is None and "first_sample_s" not in self.contents.stated:
                self.inferred.append("the first sample is taken at the onset of its pulse (depth 0), as nobody says")
                return 0.0
            return self.number("first_sample_s") or 0.0
        if speed is None:
            self.wrong("first_sample_depth_m", "a depth needs a sound speed", "sound_speed_m_per_s = 1540.0")
            return 0.0
        return 2 * depth_m / speed

    def positions_m(self, lines: int) -> FloatArray | None:
        """Return where the lines lie beside the middle, (line,); None where nobody says."""
        pitch_m = self.settings.line_pitch_m
        if pitch_m is not None:
            return np.asarray((np.arange(lines) - (lines - 1) / 2) * pitch_m, np.float64)
        stated = self.stated("line_position_m")
        if stated is None:
            return None
        position_m = np.array(stated[0], dtype=np.float64)
        if position_m.size != lines:
            self.wrong("line_position_m", f"{position_m.size} positions for {lines} lines", "one a line")
            return None
        if self.settings.line_position_m is None:
            self.inferred.append(f"line_position_m: {lines} positions by {stated[1]!r} of the file")
        return position_m
