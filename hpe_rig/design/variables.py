"""Variables of a design, the numbers of a scene that it may change: between which bounds, in which steps."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hpe_rig.bench import BenchFile
from hpe_rig.prediction import LEAST_POINTS, pulse_length_m
from hpe_rig.scene import Key, Mistake, Number, Scene, SettingsError, number_keys, resolve

DIGITS = 4
"""Significant digits of a number without steps: finer ones change no jitter by more than 0.1 %."""
WIDE = 4.0
"""Factor up and down from where it stands that a number varies by if nothing else bounds it."""


@dataclass(frozen=True, slots=True)
class Variable:
    """One number that may change: whole steps of ``step`` from ``low`` to ``high``, or ``choices``, or any number."""

    key: Key
    low: float
    high: float
    step: float | None = None
    choices: tuple[float, ...] = ()

    @property
    def discrete(self) -> bool:
        """Whether places are whole numbers."""
        return bool(self.choices) or self.step is not None

    @property
    def last(self) -> float:
        """The largest place, the least being 0."""
        if self.choices:
            return len(self.choices) - 1
        return 1.0 if self.step is None else math.floor((self.high - self._first) / self.step + 1e-9)

    @property
    def _first(self) -> float:
        return self.low if self.step is None else math.ceil(self.low / self.step - 1e-9) * self.step

    def value(self, place: float) -> Number:
        """Return the number at ``place``, from 0 to ``last``."""
        if self.choices:
            return self.choices[round(place)]
        if self.step is not None:
            number = self._first + round(place) * self.step
            return round(number) if self.key.whole else float(f"{number:.12g}")
        raw = self.low * (self.high / self.low) ** place if self._ratio else self.low + place * (self.high - self.low)
        return min(max(float(f"{raw:.{DIGITS}g}"), self.low), self.high)

    def place(self, value: Number) -> float:
        """Return the place nearest to ``value``."""
        if self.choices:
            return min(range(len(self.choices)), key=lambda index: abs(self.choices[index] - value))
        if self.step is not None:
            return min(max(round((value - self._first) / self.step), 0), self.last)
        inside = min(max(value, self.low), self.high)
        if self._ratio:
            return math.log(inside / self.low) / math.log(self.high / self.low)
        return (inside - self.low) / (self.high - self.low)

    @property
    def _ratio(self) -> bool:
        return self.low > 0


def variables(
    tables: Mapping[str, Any],
    scene: Scene,
    bench: BenchFile,
    longest_s: float,
    names: Sequence[str],
    bounds: Sequence[str],
) -> tuple[Variable, ...]:
    """Return what ``names`` and ``bounds`` ("key=low:high") ask for; raise ``SettingsError`` with every mistake."""
    keys, mistakes = number_keys(tables), list[Mistake]()
    asked = _found(names, keys, mistakes)
    limits: dict[str, tuple[float, float]] = {}
    for text in bounds:
        name, _, span = text.partition("=")
        pair = _span(span)
        (key,) = _found([name.strip()], keys, mistakes) or (None,)
        if pair is None:
            mistakes.append(Mistake(f"--bound {text}", "this is no bound", "key=low:high with low below high"))
        elif key is not None and key not in asked:
            mistakes.append(Mistake(f"--bound {text}", "this key is not varied", f"--over {key} as well"))
        elif key is not None:
            limits[str(key)] = pair
    if not names:
        mistakes.append(Mistake("--over", "nothing may change", "keys such as pulse_rate_hz,gate_length_m"))
    found = []
    for key in dict.fromkeys(asked):
        variable = _variable(key, scene, bench, longest_s, limits.get(str(key)))
        if isinstance(variable, Mistake):
            mistakes.append(variable)
        else:
            found.append(variable)
    if mistakes:
        raise SettingsError("command line", mistakes)
    return tuple(found)


def _found(names: Sequence[str], keys: Sequence[Key], mistakes: list[Mistake]) -> list[Key]:
    each = [resolve(name, keys) for name in names]
    mistakes += [item for item in each if isinstance(item, Mistake)]
    return [item for item in each if isinstance(item, Key)]


def _span(text: str) -> tuple[float, float] | None:
    try:
        low, high = map(float, text.split(":"))
    except ValueError:
        return None
    return (low, high) if -math.inf < low < high < math.inf else None


def _variable(
    key: Key, scene: Scene, bench: BenchFile, longest_s: float, given: tuple[float, float] | None
) -> Variable | Mistake:
    step, offered = _steps(key, scene, bench)
    bounds = given or _bounds(key, scene, bench, longest_s)
    if bounds is None:
        return Mistake(str(key), "it has no value to start from and no limit", f"--bound {key}=low:high")
    low, high = bounds if given or step or offered else _inward(*bounds)
    choices = tuple(choice for choice in offered if low <= choice <= high)
    variable = Variable(key, low, high, step, choices)
    if not low < high or variable.last < 1 or (offered and not choices):
        remedy = f"--bound {key}=low:high with room for two values"
        return Mistake(str(key), f"from {low:.6g} to {high:.6g} it has no two values to choose from", remedy)
    return variable


def _inward(low: float, high: float) -> tuple[float, float]:
    """Return bounds of `DIGITS` digits that lie within."""

    def rounded(number: float, whole: Callable[[float], int]) -> float:
        unit = 10.0 ** (math.floor(math.log10(abs(number))) - DIGITS + 1) if number else 1.0
        return float(f"{whole(number / unit * (1 - 1e-12)) * unit:.{DIGITS}g}")

    return rounded(low, math.ceil), rounded(high, math.floor)


def _steps(key: Key, scene: Scene, bench: BenchFile) -> tuple[float | None, tuple[float, ...]]:
    """Return step or choices of a number that bench or scene take in steps only."""
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
    return (1.0 if key.whole else None), ()


def _bounds(key: Key, scene: Scene, bench: BenchFile, longest_s: float) -> tuple[float, float] | None:
    """Return the bounds that scene and bench imply, else a factor `WIDE` about the value; None without a value."""
    name = str(key).partition("[")[0]
    if name in _BOUNDS and (scene.excitation is not None or not name.startswith("excitation")):
        return _BOUNDS[name](scene, bench, longest_s)
    if key.value is None or key.value == 0:
        return None
    low, high = sorted((key.value / WIDE, key.value * WIDE))
    return (max(1.0, math.floor(low)), math.ceil(high)) if key.whole else (low, high)


def _highest_pulse_rate_hz(scene: Scene) -> float:
    gate = scene.acquisition
    return gate.sound_speed_m_per_s / (2 * gate.gate_depth_m + gate.gate_length_m)


def _record_m(scene: Scene, samples: float) -> float:
    return samples / scene.acquisition.sample_rate_hz * scene.acquisition.sound_speed_m_per_s / 2


def _first_hz(scene: Scene) -> float:
    return min(scene.wanted_frequencies_hz, default=1.0)


def _burst_length_s(scene: Scene, bench: BenchFile, longest_s: float) -> tuple[float, float]:
    assert scene.excitation is not None  # noqa: S101
    most_s = bench.limits.max_duty / scene.excitation.burst_rate_hz
    return 1 / scene.excitation.carrier_hz, min(bench.limits.max_burst_length_s, most_s)


def _burst_count(scene: Scene, bench: BenchFile, longest_s: float) -> tuple[float, float]:
    assert scene.excitation is not None  # noqa: S101
    return 1, max(2, min(bench.limits.max_bursts, math.floor(longest_s * scene.excitation.burst_rate_hz + 1e-6)))


def _cycles(scene: Scene, bench: BenchFile, longest_s: float) -> tuple[float, float]:
    # Half the received length: a longer pulse would be longer than what is declared of its echo.
    carrier_m = scene.acquisition.sound_speed_m_per_s / 2 / scene.tracking.carrier_hz
    return 1, max(2, scene.tracking.cycles, math.floor(pulse_length_m(scene) / carrier_m / 2))


_BOUNDS: dict[str, Callable[[Scene, BenchFile, float], tuple[float, float]]] = {
    "tracking.pulse_rate_hz": lambda scene, _, __: (LEAST_POINTS * _first_hz(scene), _highest_pulse_rate_hz(scene)),
    "tracking.delay_s": lambda scene, _, __: (0.0, 1 / scene.tracking.pulse_rate_hz),
    "tracking.pulse_count": lambda scene, _, longest_s: (4, max(5, longest_s * _highest_pulse_rate_hz(scene))),
    "tracking.cycles": _cycles,
    # A wavelength: two cycles of the echo.
    "acquisition.gate_length_m": lambda scene, _, __: (
        scene.acquisition.sound_speed_m_per_s / scene.tracking.carrier_hz,
        _record_m(scene, scene.acquisition.record_samples),
    ),
    "acquisition.record_samples": lambda scene, bench, _: (
        bench.digitizer.board_model.record_minimum,
        max(WIDE * scene.acquisition.record_samples, 1024),
    ),
    "acquisition.sample_rate_hz": lambda scene, _, __: (2 * scene.tracking.carrier_hz, math.inf),
    "acquisition.input_range_v": lambda _, __, ___: (0.0, math.inf),
    "acquisition.repeats": lambda scene, _, __: (1, max(2, scene.acquisition.repeats)),
    "excitation.burst_length_s": _burst_length_s,
    "excitation.burst_count": _burst_count,
    "excitation.force_fraction": lambda _, __, ___: (0.01, 1.0),
    # The model knows no start-up: what the scene leaves out of it stays left out.
    "processing.window_start_s": lambda scene, _, longest_s: (scene.processing.window_start_s, longest_s),
    "processing.window_length_s": lambda scene, _, longest_s: (1 / _first_hz(scene), longest_s),
}
