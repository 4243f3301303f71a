"""World: the whole simulated bench. Registers -> edges along the wiring -> bursts -> volts at the digitizer.

Assumed: if every output is off when a capture is armed, no motion remains from before.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from sim_backend.arrays import FloatArray, Int64Array
from sim_backend.digitizer import (
    BOARDS,
    FAR_PS,
    INPUTS,
    AcceptedTriggers,
    AlazarLibrary,
    Board,
    BoardSettings,
    CaptureSnapshot,
    Latencies,
    Recording,
    direct_volts,
    pulse_onsets_ps,
)
from sim_backend.generator import MODELS, TRIGGER_INPUT_OHM, TRIGGER_LEVEL_V, Generator33250A, ScpiError, with_serial
from sim_backend.settings import Instruments, SimulationSettings
from sim_backend.wiring import (
    PS_PER_S,
    Bursts,
    Cable,
    Capture,
    Emission,
    Plug,
    Respond,
    SimulatedClock,
    Steps,
    bursts_at_amplifiers,
    cables_of,
    crossings,
    propagate,
    to_ps,
    trigger_order,
)

if TYPE_CHECKING:
    from sim_backend.receiver import Physics

GENERATORS = ("master", "burst_train", "toneburst", "tracking_train", "tracking_pulser")
PULSER = "tracking_pulser"
TRANSDUCERS = ("transducer.drive", "tracking_transducer.drive")
"""Inputs of the pushing transducer, and of a transducer for tracking alone."""
SOURCES = (*(f"{role}.output" for role in GENERATORS), "digitizer.aux")
TARGETS = (*(f"{role}.trigger" for role in GENERATORS), "digitizer.trigger", *TRANSDUCERS, *INPUTS)
MAX_CAPTURES = 16
"""Number of armings in memory, with their emissions; older ones are forgotten."""


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Emissions of every instrument up to ``until_ps``, and the bursts that reach the transducers."""

    emissions: Mapping[str, Emission]
    tonebursts: Bursts
    pulses: Bursts
    captured: CaptureSnapshot | None
    until_ps: int


@dataclass(eq=False)
class GeneratorConnection:
    """Text connection to one generator; every message takes ``message_time_s``."""

    generator: Generator33250A
    clock: SimulatedClock
    message_time_s: float
    over_serial: bool = False
    """Whether the line is serial, on which the generator has a local mode."""

    def write(self, message: str) -> None:
        """Send a message."""
        self.clock.sleep(self.message_time_s)
        self.generator.write(message, self.over_serial)

    def read(self) -> str:
        """Return one reply; raise ``TimeoutError`` if there is none."""
        return self.generator.read()

    def serial_poll(self) -> int:
        """Return the status byte, as by a serial poll on the bus."""
        return self.generator.serial_poll()

    def close(self) -> None:
        """Close the connection; the instrument keeps its state."""
        self.generator.close()


def _generator(
    clock: SimulatedClock, instruments: Instruments, model: str, role: str, identity: str | None
) -> Generator33250A:
    """Return the simulated generator of ``role``, such as "toneburst", of ``model``.

    With ``instruments.serial_numbers`` a program can tell equal generators apart: by the serial number, or on a 33250A,
    which reports none, by the name that the user gave to stored state 4. ``identity`` is this number or name; default:
    one made from the role.
    """
    number = 1 + GENERATORS.index(role)
    serial = (identity or f"MY4400000{number}") if instruments.serial_numbers else "0"
    clock_error: float = getattr(instruments.clock_error, role)
    generator = Generator33250A(clock, instruments.generator_latency_s, with_serial(MODELS[model], serial), clock_error)
    # A clock without an error is locked to the reference of the bench.
    generator.status.has_external_reference = clock_error == 0
    if instruments.serial_numbers:
        generator.states.rename(("4", f"SIM_BOX_{number}"))
        if identity is not None:
            # A serial number may be no valid name of a state; then the name above stays.
            with suppress(ScpiError):
                generator.states.rename(("4", identity))
    return generator


class Silence:
    """Acoustics of a bench with its amplifier off: no motion, no echo, no noise."""

    def record_volts(self, tonebursts: Bursts, pulses: Bursts, capture: Capture) -> FloatArray:
        """Return the voltage of records without echoes and noise: zeros (record, sample)."""
        return np.zeros((capture.first_sample_ps.size, capture.samples))

    def focus_displacement_m(
        self, tonebursts: Bursts, time_ps: Int64Array, origin_ps: int, *, index: int = 0
    ) -> FloatArray:
        """Return the displacement of a specimen that nothing pushes: zeros (time,)."""
        return np.zeros(time_ps.shape)


class World:
    """Five generators and a digitizer with their wiring; time advances with the program's calls alone.

    Args:
        settings: the scene's [simulation], and the twin's settings.
        wiring: the cables as they are plugged in.
        acoustics: replaces the twin's acoustics.
        models: models by role; generators without an entry are 33250A, and a digitizer is an ATS460.
        first_capture: index of the first arming, which seeds its noise.
        boxes: by role, the generator of the wiring that answers at the role's address; default: the role's.
        serials: serial numbers and labels by role, the digitizer's included; default: the twin's.

    Raises ``ValueError`` for an unknown end of a cable, and for a loop of triggers.
    """

    def __init__(
        self,
        settings: SimulationSettings,
        wiring: Sequence[Plug],
        acoustics: Physics | None = None,
        models: Mapping[str, str] | None = None,
        first_capture: int = 0,
        boxes: Mapping[str, str] | None = None,
        serials: Mapping[str, str] | None = None,
    ) -> None:
        """Build the simulated bench: clock, generators, digitizer and the cables of ``wiring``."""
        instruments = settings.instruments
        self._settings = settings
        self._boxes = boxes or {}
        self._added: tuple[Cable, ...] = ()
        self._cables = cables_of(wiring, SOURCES, TARGETS)
        trigger_order(self._cables, (*GENERATORS, "digitizer"))
        # Acoustics given by the caller hold for every lateral offset; the twin's are built for one, at their first use.
        self._acoustics_given = acoustics is not None
        self._physics = acoustics
        self._lateral_m = 0.0
        self.clock = SimulatedClock()
        self._generators = {
            role: _generator(
                self.clock, instruments, (models or {}).get(role, "33250A"), role, (serials or {}).get(role)
            )
            for role in GENERATORS
        }
        board_type = BOARDS[(models or {}).get("digitizer", "ATS460")]
        latencies = Latencies(
            to_ps(instruments.digitizer_latency_s),
            to_ps(instruments.aux_latency_s),
            instruments.aux_waits_for_trigger_delay,
        )
        board_serial = (serials or {}).get("digitizer", "")
        self.board = Board(
            latencies,
            board_type,
            BoardSettings(board_type),
            count=first_capture,
            faults=instruments.trigger_faults,
            clock_error=instruments.clock_error.digitizer,
            serial_number=int(board_serial) if board_serial.isdecimal() else None,
        )
        # The last evaluation, and the instruments' counters of changes for which it is valid.
        self._evaluated: tuple[tuple[int, ...], Evaluation] | None = None
        # Records of the last capture.
        self._recording: Recording | None = None
        # Signals of the captures before the last one.
        self._past: deque[CaptureSnapshot] = deque(maxlen=MAX_CAPTURES - 1)

    def connect(self, role: str, over_serial: bool = False) -> GeneratorConnection:
        """Return a text connection to the generator at the address of ``role``; raise ``ValueError`` for others."""
        if role not in self._generators:
            raise ValueError(f"no generator {role!r} on the simulated bench; it has {', '.join(GENERATORS)}")
        # Addresses may be swapped: then the generator that is wired for another role answers.
        generator = self._generators[self._boxes.get(role, role)]
        return GeneratorConnection(generator, self.clock, self._settings.instruments.message_time_s, over_serial)

    def plug(self, cables: Sequence[Plug]) -> None:
        """Add ``cables`` to the wiring by T pieces; those added before are removed."""
        self._added = cables_of(cables, SOURCES, TARGETS)
        # The cached evaluation is that of the old wiring.
        self._evaluated = None

    def move_tracking(self, lateral_m: float) -> None:
        """Move the tracking transducer to a lateral offset from the push, for all captures from now on."""
        if lateral_m != self._lateral_m:
            self._lateral_m = lateral_m
            # The twin's own acoustics are for the old offset: discarded, they are built for the new one at next use.
            if not self._acoustics_given:
                self._physics = None

    def alazar_library(self) -> AlazarLibrary:
        """Return the digitizer's function table, freshly loaded."""
        return AlazarLibrary(self, self._settings.instruments)

    def outputs_on(self) -> dict[str, bool]:
        """Return whether each generator's output is on, by role."""
        return {role: generator.registers.output for role, generator in self._generators.items()}

    def is_capturing(self) -> bool:
        """Return whether the digitizer waits for records; without a call, a capture ends with its last record."""
        return (
            self.board.running
            and self.triggers(self.clock.now_ps).complete(self.clock.now_ps)
            < self.board.armings[-1].settings.record_count
        )

    def emissions(self) -> tuple[Bursts, Bursts, dict[str, int]]:
        """Return tonebursts and tracking pulses at the transducer, and the number of ignored triggers by role.

        They include everything since the generators' outputs were last all off when a capture was armed, and the future
        bursts of trains that have been triggered.
        """
        evaluation = self._evaluate(self.clock.now_ps)
        ignored = {role: emission.ignored for role, emission in evaluation.emissions.items()}
        return evaluation.tonebursts, evaluation.pulses, ignored

    def true_displacement_m(self, capture_index: int = -1) -> FloatArray:
        """Return the true displacement at the focus (record,), at the arrival of each record's tracking pulse.

        NaN if no pulse was fired. ``capture_index`` counts the last ``MAX_CAPTURES`` armings, as a list index.
        """
        captured = self._capture(capture_index)
        # The pulse reaches the focus one flight time after its onset.
        flight_ps = to_ps(self._settings.beams.tracked_from_m / self._settings.sound_speed_m_per_s)
        onset_ps = pulse_onsets_ps(captured)
        fired = onset_ps >= 0
        displacement_m = np.full(onset_ps.size, np.nan)
        displacement_m[fired] = self._acoustics().focus_displacement_m(
            captured.tonebursts, onset_ps[fired] + flight_ps, captured.origin_ps, index=captured.arming.index
        )
        return displacement_m

    def true_motion_m(self, time_s: FloatArray) -> FloatArray:
        """Return the true displacement at the focus at ``time_s`` after the master trigger's edge: (time,)."""
        captured = self._capture(-1)
        time_ps = captured.origin_ps + np.round(time_s * PS_PER_S).astype(np.int64)
        return self._acoustics().focus_displacement_m(
            captured.tonebursts, time_ps, captured.origin_ps, index=captured.arming.index
        )

    def _capture(self, index: int) -> CaptureSnapshot:
        """Return the bench's signals for capture ``index``; raise ``IndexError`` if it does not exist."""
        captures = [*self._past, self._last_capture(self.clock.now_ps)] if self.board.armings else []
        if not -len(captures) <= index < len(captures):
            raise IndexError(f"capture {index} of {len(captures)}: arm the digitizer before asking for the truth")
        return captures[index]

    # Interface of the digitizer's library (`state.Recorder`)

    def arm(self, settings: BoardSettings) -> None:
        """Start a capture with ``settings``."""
        self.board.stop(self.clock.now_ps)
        if self.board.armings:
            self._past.append(self._last_capture(self.clock.now_ps))
        if not any(self.outputs_on().values()):
            # Nothing earlier matters, so the time a shot takes does not grow with the measurement.
            for generator in self._generators.values():
                generator.forget_past()
            self.board.armings.clear()
        self.board.arm(self.clock.now_ps, settings)
        # The records so far are those of the capture before.
        self._recording = None

    def triggers(self, until_ps: int) -> AcceptedTriggers:
        """Return the accepted triggers of the last arming, complete at least up to ``until_ps``."""
        return self._last_capture(until_ps).triggers

    def volts(self, until_ps: int, records: slice, channel: int) -> FloatArray:
        """Return the voltage at ``channel`` for consecutive ``records``, (record, sample).

        It is the sum of the signals of all cables to that input; echoes are at channel 0.
        """
        # A slice, because a channel without an input on the bench has no cables.
        inputs = INPUTS[channel : channel + 1]
        arriving = [cable for cable in (*self._cables, *self._added) if cable.target in inputs]
        if channel == 0 and not arriving:
            return self._recorded(until_ps).volts(records)
        capture = self._last_capture(until_ps).capture
        direct_v = direct_volts(arriving, self._evaluate(until_ps).emissions, capture, records)
        return direct_v + self._recorded(until_ps).volts(records) if channel == 0 else direct_v

    def peak_v(self, until_ps: int, count: int) -> float:
        """Return the largest absolute voltage of the echoes at channel A in the first ``count`` records."""
        return self._recorded(until_ps).peak_v(count)

    def _recorded(self, until_ps: int) -> Recording:
        """Return the records of the last capture that are sampled by now.

        Triggers and bursts before ``until_ps`` count. The object is the same at every call for one capture, because it
        stores the voltages that it has computed.
        """
        if self._recording is None:
            self._recording = Recording(self._acoustics().record_volts)
        self._recording.update(self._last_capture(until_ps), self.clock.now_ps)
        return self._recording

    def _acoustics(self) -> Physics:
        """Return the physics of the echoes, created at its first use."""
        if self._physics is None:
            from sim_backend.acoustics import Acoustics
            from sim_backend.receiver import with_reception

            self._physics = with_reception(Acoustics(self._settings, self._lateral_m), self._settings)
        return self._physics

    def _evaluate(self, until_ps: int) -> Evaluation:
        """Return the signals of the bench, the bursts and triggers of all generators, up to ``until_ps`` at least.

        The last evaluation is cached until an instrument changes.
        """
        version = self.board.changes, *(generator.changes for generator in self._generators.values())
        if self._evaluated is not None and self._evaluated[0] == version and self._evaluated[1].until_ps >= until_ps:
            return self._evaluated[1]
        # Endless emissions are evaluated up to the next whole second, others to their end.
        is_endless = any(generator.endless for generator in self._generators.values())
        next_second_ps = -(-(until_ps + 1) // PS_PER_S) * PS_PER_S
        evaluation = self._propagate(next_second_ps if is_endless else FAR_PS)
        self._evaluated = (version, evaluation)
        return evaluation

    def _propagate(self, until_ps: int) -> Evaluation:
        """Return all signals up to ``until_ps``: emissions, bursts at the transducer and the last capture."""
        triggers: list[AcceptedTriggers] = []

        def digitizer(arriving: Steps) -> Emission:
            """Return the signal at the digitizer's AUX output for the edges ``arriving`` at its trigger input.

            The triggers accepted in each arming are appended to ``triggers``.
            """
            emission, by_arming = self.board.respond(arriving)
            triggers.extend(by_arming)
            return emission

        respond: dict[str, Respond] = {
            role: partial(generator.emission, until_ps=until_ps) for role, generator in self._generators.items()
        }
        cables = (*self._cables, *self._added)
        emissions = propagate(cables, {**respond, "digitizer": digitizer}, INPUTS)
        # The transducer receives the sum of all generators; the pulser's bursts are tracking pulses.
        tonebursts = bursts_at_amplifiers(self._cables, emissions, [role for role in GENERATORS if role != PULSER])
        pulses = bursts_at_amplifiers(self._cables, emissions, [PULSER], TRANSDUCERS)
        captured = self._snapshot(emissions, triggers[-1], tonebursts, pulses) if triggers else None
        return Evaluation(emissions, tonebursts, pulses, captured, until_ps)

    def _snapshot(
        self, emissions: Mapping[str, Emission], triggers: AcceptedTriggers, tonebursts: Bursts, pulses: Bursts
    ) -> CaptureSnapshot:
        """Return the last capture of the board: its arming, triggers, bursts and time zero."""
        arming = self.board.armings[-1]
        edges_ps = crossings(emissions["master"].steps, TRIGGER_LEVEL_V, True, TRIGGER_INPUT_OHM)
        first_ps = triggers.tick_ps[0] if triggers.tick_ps.size else arming.start_ps
        # Time zero of a capture: the last edge of the master trigger before the first record.
        before_ps = edges_ps[edges_ps <= first_ps]
        after_ps = edges_ps[edges_ps >= arming.start_ps]
        origin_ps = int(before_ps[-1] if before_ps.size else after_ps[0] if after_ps.size else arming.start_ps)
        return CaptureSnapshot(
            arming=arming, triggers=triggers, tonebursts=tonebursts, pulses=pulses, origin_ps=origin_ps
        )

    def _last_capture(self, until_ps: int) -> CaptureSnapshot:
        """Return the bench's signals for the last capture, up to ``until_ps``; raise ``ValueError`` without one."""
        captured = self._evaluate(until_ps).captured
        if captured is None:
            raise ValueError("the digitizer was never armed: start a capture first")
        return captured
