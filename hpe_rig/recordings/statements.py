"""Stated and inferred settings of a recording.

Precedence: option, sidecar, the file itself, the scene. Each value that neither option nor sidecar states is inferred,
and described in words. A needed value that is not stated, or a contradiction, is a mistake. Both are collected.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.recordings.contents import Contents
from hpe_rig.recordings.coordinates import find_coordinate
from hpe_rig.recordings.settings import RecordingSettings
from hpe_rig.scene import Mistake, mistakes_of

MAX_JITTER_PERIODS = 1e-3
"""Largest deviation of regular pulses from a fixed rate, in pulse periods."""
MAX_TIME_S = 1e3


PulseTimes = tuple[FloatArray | None, float | None, bool]
"""Times of the pulses (pulse,), s; their rate, Hz; whether the rate is fixed. None if unknown."""


@dataclass(slots=True)
class Statements:
    """Settings of one recording by precedence; ``mistakes`` and ``inferred`` are collected by its methods."""

    settings: RecordingSettings
    contents: Contents
    scene: Mapping[str, float]
    """Settings that the scene states, by key; also ``pulse_count`` and ``record_samples``."""
    origins: Mapping[str, str]
    """Origin of each of ``settings``."""
    mistakes: list[Mistake] = field(default_factory=list)
    inferred: list[str] = field(default_factory=list)

    def add_mistake(self, key: str, what: str, remedy: str) -> None:
        """Add a mistake of ``key``."""
        self.mistakes.append(Mistake(key, what, remedy))

    def stated(self, key: str) -> tuple[Any, str] | None:
        """Return the value of ``key`` in options, sidecar or file, and its origin."""
        value = getattr(self.settings, key, None)
        if value is not None:
            return value, self._origin(key)
        return self.contents.stated.get(key)

    def _origin(self, key: str) -> str:
        return self.origins.get(key, "an option")

    def number(self, key: str, needed: bool = True) -> float | None:
        """Return the value of ``key``; if it is ``needed`` and nothing states it, add a mistake."""
        value = getattr(self.settings, key, None)
        in_file = self.contents.stated.get(key)
        # Options and sidecar take precedence, but a contradiction to the file is reported.
        if value is not None:
            if in_file is not None and not np.isclose(float(in_file[0]), value, rtol=1e-6):
                self.inferred.append(f"{key} = {value:g} from {self._origin(key)}, the file states {in_file[0]:g}")
            return float(value)
        if in_file is not None:
            return self._number_of_file(key, float(in_file[0]), in_file[1])
        if key in self.scene:
            self.inferred.append(f"{key} = {self.scene[key]:g}, from the scene")
            return self.scene[key]
        if needed:
            remedy = f"--set {key}=... or a sidecar file"
            remedy += self._rate_of_times() if key == "sample_rate_hz" else ""
            self.add_mistake(key, "neither options, sidecar, file nor scene state it", remedy)
        return None

    def _rate_of_times(self) -> str:
        """Return the rate of the times in the file, whose unit is unknown, in words; "" without times."""
        for name, array in self.contents.arrays.items():
            times = find_coordinate(array) if array.ndim == 1 else None
            if times is not None and not times.is_index:
                rate = 1 / times.step
                return f"; {name!r} ascends by {times.step:g}: {rate:.6g} if in s, {1e6 * rate:.6g} if in us"
        return ""

    def _number_of_file(self, key: str, value: float, name: str) -> float | None:
        """Return the ``value`` that the file states under ``name``, unless it is out of bounds."""
        mistakes = mistakes_of(RecordingSettings, {key: value})
        if mistakes:
            what = f"{name!r} of the file states {value:g}, {mistakes[0].what}"
            self.add_mistake(key, what, f"{key} with the right value")
            return None
        self.inferred.append(f"{key} = {value:g}, from {name!r} of the file")
        return value

    def pulse_times(self, count: int | None) -> PulseTimes:
        """Return the times of ``count`` pulses; None: of an unknown number, without times."""
        stated = self.stated("pulse_time_s")
        if stated is None or (self.settings.pulse_time_s is None and self.settings.pulse_rate_hz is not None):
            return self._regular_times(count)
        values, origin = stated
        time_s = np.array(values, dtype=np.float64)
        if not self._times_are_valid(time_s, origin, count):
            return None, None, True
        # Regular pulses deviate from the fixed rate between the first and the last pulse by little.
        mean_rate_hz = (time_s.size - 1) / (time_s[-1] - time_s[0])
        fixed_rate_s = time_s[0] + np.arange(time_s.size) / mean_rate_hz
        regular = bool(np.abs(time_s - fixed_rate_s).max() * mean_rate_hz < MAX_JITTER_PERIODS)
        rate_hz = float(mean_rate_hz if regular else 1 / np.median(np.diff(time_s)))
        if self.settings.pulse_time_s is None:
            self.inferred.append(f"pulses: {time_s.size} times from {origin!r} of the file")
        spacing = "regular to 0.1 %" if regular else "irregular: each time is used"
        self.inferred.append(f"pulse_rate_hz = {rate_hz:.6g}, from {time_s.size} times, {spacing}")
        return time_s, rate_hz, regular

    def _regular_times(self, count: int | None) -> PulseTimes:
        """Return times at the stated pulse rate."""
        rate_hz = self.number("pulse_rate_hz")
        first_s = self.settings.first_pulse_s
        if first_s is None:
            first_s = self.scene.get("first_pulse_s", 0.0)
            origin = "from the scene's tracking.delay_s" if "first_pulse_s" in self.scene else "the default"
            self.inferred.append(f"the first pulse is fired {first_s:g} s after time zero of the pulses, {origin}")
        if rate_hz is None or count is None:
            return None, rate_hz, True
        return first_s + np.arange(count) / rate_hz, rate_hz, True

    def _times_are_valid(self, time_s: FloatArray, origin: str, count: int | None) -> bool:
        """Return whether the times of the pulses are valid; add a mistake if they are not."""
        if count is not None and time_s.size != count:
            what, remedy = f"{time_s.size} times ({origin}) for {count} pulses", "one time per pulse"
        elif not np.isfinite(time_s).all() or not np.all(np.diff(time_s) > 0):
            index = int(np.argmax(~(np.diff(time_s) > 0))) + 1
            what = f"times ({origin}) do not ascend: pulse {index + 1} comes at {time_s[index]:g} s after "
            what += f"{time_s[index - 1]:g} s"
            remedy = "the times of the pulses in their order, s"
        elif time_s[0] < 0 or time_s[-1] > MAX_TIME_S:
            what, remedy = f"times ({origin}) run from {time_s[0]:g} to {time_s[-1]:g} s", "seconds from 0 on"
        else:
            return True
        self.add_mistake("pulse_time_s", what, remedy)
        return False

    def first_sample_s(self, sound_speed_m_per_s: float | None) -> float:
        """Return the time of the first sample of a record after the onset of its pulse."""
        depth_m = self.settings.first_sample_depth_m
        if depth_m is None:
            if self.settings.first_sample_s is None and "first_sample_s" not in self.contents.stated:
                what = "the first sample is acquired at the onset of its pulse (depth 0)"
                what = what if self.settings.quantity is None else "the first value lies at depth 0"
                self.inferred.append(f"{what}, the default")
                return 0.0
            return self.number("first_sample_s") or 0.0
        if sound_speed_m_per_s is None:
            self.add_mistake("first_sample_depth_m", "a depth needs a sound speed", "sound_speed_m_per_s = 1540.0")
            return 0.0
        # Time of flight to the depth and back.
        return 2 * depth_m / sound_speed_m_per_s

    def line_positions_m(self, lines: int) -> FloatArray | None:
        """Return the lateral offsets of the lines from the push, (line,); None if they are not stated."""
        pitch_m = self.settings.line_pitch_m
        if pitch_m is not None:
            # Lines are centred on the push.
            return np.asarray((np.arange(lines) - (lines - 1) / 2) * pitch_m, np.float64)
        stated = self.stated("line_position_m")
        if stated is None:
            return None
        position_m = np.array(stated[0], dtype=np.float64)
        if position_m.size != lines:
            what = f"{position_m.size} positions for {lines} lines"
            self.add_mistake("line_position_m", what, "one position per line")
            return None
        if self.settings.line_position_m is None:
            self.inferred.append(f"line_position_m: {lines} positions from {stated[1]!r} of the file")
        return position_m
