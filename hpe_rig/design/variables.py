"""Variables of a design: the numbers of a scene that may change, with their bounds and steps.

The search works on positions from 0 to ``Variable.last``: an index for discrete numbers, else a fraction of the range,
logarithmic for positive numbers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hpe_rig.bench import BenchFile
from hpe_rig.prediction import MIN_PULSES_PER_CYCLE, pulse_length_m
from hpe_rig.scene import Axis, Key, Mistake, Number, Scene, SettingsError, number_keys, resolve

DIGITS = 4
"""Significant digits of a continuous number: finer ones change no jitter by more than 0.1 %."""
DEFAULT_RANGE = 4.0
"""Factor up and down from the starting value for a number without other bounds."""


@dataclass(frozen=True, slots=True)
class Variable:
    """One number that may change: multiples of ``step`` from ``low`` to ``high``, or ``choices``, or continuous."""

    key: Key
    low: float
    high: float
    step: float | None = None
    choices: tuple[float, ...] = ()

    @property
    def discrete(self) -> bool:
        """Whether positions are integers."""
        return bool(self.choices) or self.step is not None

    @property
    def last(self) -> float:
        """The largest position."""
        if self.choices:
            return len(self.choices) - 1
        return 1.0 if self.step is None else math.floor((self.high - self._first) / self.step + 1e-9)

    @property
    def _first(self) -> float:
        return self.low if self.step is None else math.ceil(self.low / self.step - 1e-9) * self.step

    @property
    def _logarithmic(self) -> bool:
        return self.low > 0

    def value(self, position: float) -> Number:
        """Return the number at ``position``."""
        if self.choices:
            return self.choices[round(position)]
        if self.step is not None:
            number = self._first + round(position) * self.step
            return round(number) if self.key.is_integer else float(f"{number:.12g}")
        if self._logarithmic:
            number = self.low * (self.high / self.low) ** position
        else:
            number = self.low + position * (self.high - self.low)
        return min(max(float(f"{number:.{DIGITS}g}"), self.low), self.high)

    def position(self, value: Number) -> float:
        """Return the position nearest to ``value``."""
        if self.choices:
            return min(range(len(self.choices)), key=lambda index: abs(self.choices[index] - value))
        if self.step is not None:
            return min(max(round((value - self._first) / self.step), 0), self.last)
        # A starting value may lie outside the bounds.
        clipped = min(max(value, self.low), self.high)
        if self._logarithmic:
            return math.log(clipped / self.low) / math.log(self.high / self.low)
        return (clipped - self.low) / (self.high - self.low)

    def axis(self, points: int) -> Axis:
        """Return at most ``points`` different values, evenly spaced in position, as a sweep."""
        positions = np.linspace(0.0, self.last, points)
        values = {self.value(round(position) if self.discrete else position) for position in positions}
        return Axis.of_key(str(self.key), sorted(values))


def variables(
    tables: Mapping[str, Any],
    scene: Scene,
    bench: BenchFile,
    longest_s: float,
    names: Sequence[str],
    bounds: Sequence[str],
) -> tuple[Variable, ...]:
    """Return the variables of the options ``names`` and ``bounds`` ("key=low:high").

    Raises ``SettingsError`` with every mistake.
    """
    keys, mistakes = number_keys(tables), list[Mistake]()
    varied = _resolved(names, keys, mistakes)
    limits: dict[str, tuple[float, float]] = {}
    for text in bounds:
        name, _, span = text.partition("=")
        limit = _parsed_bounds(span)
        (key,) = _resolved([name.strip()], keys, mistakes) or (None,)
        if limit is None:
            mistakes.append(Mistake(f"--bound {text}", "this is no bound", "key=low:high with low below high"))
        elif key is not None and key not in varied:
            mistakes.append(Mistake(f"--bound {text}", "this key is not varied", f"--over {key} as well"))
        elif key is not None:
            limits[str(key)] = limit
    if not names:
        mistakes.append(Mistake("--over", "nothing may change", "keys such as pulse_rate_hz,gate_length_m"))
    space = [_variable(key, scene, bench, longest_s, limits.get(str(key))) for key in dict.fromkeys(varied)]
    mistakes += [item for item in space if isinstance(item, Mistake)]
    if mistakes:
        raise SettingsError("command line", mistakes)
    return tuple(item for item in space if isinstance(item, Variable))


def _resolved(names: Sequence[str], keys: Sequence[Key], mistakes: list[Mistake]) -> list[Key]:
    """Return the keys of ``names``; add unknown names to ``mistakes``."""
    resolutions = [resolve(name, keys) for name in names]
    mistakes += [item for item in resolutions if isinstance(item, Mistake)]
    return [item for item in resolutions if isinstance(item, Key)]


def _parsed_bounds(text: str) -> tuple[float, float] | None:
    try:
        low, high = map(float, text.split(":"))
    except ValueError:
        return None
    return (low, high) if -math.inf < low < high < math.inf else None


def _variable(
    key: Key, scene: Scene, bench: BenchFile, longest_s: float, bounds: tuple[float, float] | None
) -> Variable | Mistake:
    """Return the variable of ``key``; ``bounds``, if not None, replace the default bounds."""
    step, choices = _steps(key, scene, bench)
    limits = bounds or _default_bounds(key, scene, bench, longest_s)
    if limits is None:
        return Mistake(str(key), "it has no value to start from and no limit", f"--bound {key}=low:high")
    low, high = limits if bounds or step or choices else _rounded_inward(*limits)
    allowed = tuple(choice for choice in choices if low <= choice <= high)
    variable = Variable(key, low, high, step, allowed)
    if not low < high or variable.last < 1 or (choices and not allowed):
        remedy = f"--bound {key}=low:high with room for two values"
        return Mistake(str(key), f"from {low:.6g} to {high:.6g} it has no two values to choose from", remedy)
    return variable


def _rounded_inward(low: float, high: float) -> tuple[float, float]:
    """Return bounds of `DIGITS` digits within the given ones."""

    def rounded(number: float, to_integer: Callable[[float], int]) -> float:
        unit = 10.0 ** (math.floor(math.log10(abs(number))) - DIGITS + 1) if number else 1.0
        return float(f"{to_integer(number / unit * (1 - 1e-12)) * unit:.{DIGITS}g}")

    return rounded(low, math.ceil), rounded(high, math.floor)


def _steps(key: Key, scene: Scene, bench: BenchFile) -> tuple[float | None, tuple[float, ...]]:
    """Return the step and the choices that the bench or the scene prescribe for a number."""
    board = bench.digitizer.board_model
    match str(key).partition("[")[0]:
        case "acquisition.sample_rate_hz":
            return None, board.sample_rates_hz
        case "acquisition.input_range_v":
            return None, board.input_ranges_v
        case "acquisition.record_samples":
            return board.record_multiple, ()
        case "excitation.burst_length_s" if scene.excitation is not None:
            return 1 / scene.excitation.carrier_hz, ()
        case "tracking.pulse_rate_hz" if scene.excitation is not None and scene.processing.synchronous:
            return scene.excitation.burst_rate_hz, ()
    return (1.0 if key.is_integer else None), ()


def _default_bounds(key: Key, scene: Scene, bench: BenchFile, longest_s: float) -> tuple[float, float] | None:
    """Return the bounds implied by scene and bench, else ``DEFAULT_RANGE`` about the value; None without a value."""
    name = str(key).partition("[")[0]
    if name in _BOUNDS and (scene.excitation is not None or not name.startswith("excitation")):
        return _BOUNDS[name](scene, bench, longest_s)
    if key.value is None or key.value == 0:
        return None
    low, high = sorted((key.value / DEFAULT_RANGE, key.value * DEFAULT_RANGE))
    return (max(1.0, math.floor(low)), math.ceil(high)) if key.is_integer else (low, high)


def _max_pulse_rate_hz(scene: Scene) -> float:
    """Return the pulse rate with a period equal to the delay of the echo from the gate's far end."""
    acquisition = scene.acquisition
    return acquisition.sound_speed_m_per_s / (2 * acquisition.gate_depth_m + acquisition.gate_length_m)


def _lowest_hz(scene: Scene) -> float:
    return min(scene.wanted_frequencies_hz, default=1.0)


def _burst_length_s(scene: Scene, bench: BenchFile, longest_s: float) -> tuple[float, float]:
    assert scene.excitation is not None  # noqa: S101
    max_duty_s = bench.limits.max_duty / scene.excitation.burst_rate_hz
    return 1 / scene.excitation.carrier_hz, min(bench.limits.max_burst_length_s, max_duty_s)


def _burst_count(scene: Scene, bench: BenchFile, longest_s: float) -> tuple[float, float]:
    assert scene.excitation is not None  # noqa: S101
    return 1, max(2, min(bench.limits.max_bursts, math.floor(longest_s * scene.excitation.burst_rate_hz + 1e-6)))


def _cycles(scene: Scene, bench: BenchFile, longest_s: float) -> tuple[float, float]:
    # Half the received length: a longer transmitted pulse would exceed the declared length of its echo.
    carrier_m = scene.acquisition.sound_speed_m_per_s / 2 / scene.tracking.carrier_hz
    return 1, max(2, scene.tracking.cycles, math.floor(pulse_length_m(scene) / carrier_m / 2))


_BOUNDS: dict[str, Callable[[Scene, BenchFile, float], tuple[float, float]]] = {
    "tracking.pulse_rate_hz": lambda scene, _, __: (
        MIN_PULSES_PER_CYCLE * _lowest_hz(scene),
        _max_pulse_rate_hz(scene),
    ),
    "tracking.delay_s": lambda scene, _, __: (0.0, 1 / scene.tracking.pulse_rate_hz),
    "tracking.pulse_count": lambda scene, _, longest_s: (4, max(5, longest_s * _max_pulse_rate_hz(scene))),
    "tracking.cycles": _cycles,
    # At least a wavelength, two cycles of the echo; at most the record.
    "acquisition.gate_length_m": lambda scene, _, __: (
        scene.acquisition.sound_speed_m_per_s / scene.tracking.carrier_hz,
        scene.acquisition.record_samples / scene.acquisition.sample_rate_hz * scene.acquisition.sound_speed_m_per_s / 2,
    ),
    "acquisition.record_samples": lambda scene, bench, _: (
        bench.digitizer.board_model.record_minimum,
        max(DEFAULT_RANGE * scene.acquisition.record_samples, 1024),
    ),
    "acquisition.sample_rate_hz": lambda scene, _, __: (2 * scene.tracking.carrier_hz, math.inf),
    "acquisition.input_range_v": lambda _, __, ___: (0.0, math.inf),
    "acquisition.repeats": lambda scene, _, __: (1, max(2, scene.acquisition.repeats)),
    "excitation.burst_length_s": _burst_length_s,
    "excitation.burst_count": _burst_count,
    "excitation.force_fraction": lambda _, __, ___: (0.01, 1.0),
    # The model has no transient: the window starts no earlier than that of the scene.
    "processing.window_start_s": lambda scene, _, longest_s: (scene.processing.window_start_s, longest_s),
    "processing.window_length_s": lambda scene, _, longest_s: (1 / _lowest_hz(scene), longest_s),
}
