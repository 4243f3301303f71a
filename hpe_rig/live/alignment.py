"""Alignment of the focus on the specimen: single tracking shots, no toneburst, repeated until stopped."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import final

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.bench import Bench, open_bench
from hpe_rig.live.server import LivePage
from hpe_rig.live.state import State, band_verdict, image_state, level_state, rf_state
from hpe_rig.measurement import Setup, ShotBlock, acquire
from hpe_rig.plan import Plan, Shot, check_plan, make_plan, refuse_conflicts
from hpe_rig.report import EchoView, echo_view
from hpe_rig.scene import Mistake, Scene, SettingsError
from hpe_rig.store import ShotRecords, StoreError, assemble

LONGEST_MEMORY = 240
"""Single shots that the M-mode image holds."""
SHOT_PERIOD_S = 0.05
"""Twenty single shots a second are as many as an eye follows."""

BAND_PERCENT = (10.0, 80.0)
"""Share of full scale in which the largest echo in the gate is to be: below, bits are wasted; above, echoes clip."""

ABOUT_VIBRATION = ("pulse count", "frequencies", "aliasing", "resolution", "synchronous")
"""Checks of a plan that ask whether a vibration can be estimated: no question for a single pulse."""


def without_pushing(setup: Setup) -> Setup:
    """Return ``setup`` with one tracking pulse a shot and no toneburst; raise ``PlanError`` where it cannot run."""
    scene = setup.scene.scene
    tracking = scene.tracking.model_copy(update={"pulse_count": 1})
    processing = scene.processing.model_copy(
        update={"frequencies_hz": None, "window_start_s": 0.0, "window_length_s": None, "synchronous": False}
    )
    acquisition = scene.acquisition.model_copy(update={"repeats": 1, "shot_period_s": None})
    parts = {"excitation": None, "tracking": tracking, "processing": processing, "acquisition": acquisition}
    single = scene.model_copy(update=parts)
    bench = setup.bench.bench
    plan = make_plan(single, bench)
    found = tuple(item for item in check_plan(single, bench, plan) if item.check not in ABOUT_VIBRATION)
    refuse_conflicts(found)
    return Setup(replace(setup.scene, scene=single), setup.bench, plan, found)


def band_percent(text: str) -> tuple[float, float]:
    """Return the band that ``text`` names in percent of full scale, such as 10:80; raise ``SettingsError``."""
    low, _, high = text.partition(":")
    with contextlib.suppress(ValueError):
        if 0 <= float(low) < float(high) <= 100:
            return float(low), float(high)
    mistake = Mistake(
        "--band", f"{text!r} is no band of full scale", "two percentages, the lower one first, such as 10:80"
    )
    raise SettingsError("command line", [mistake])


@final
class AlignSource:
    """The single shots so far; written by the thread that acquires, read by the one that serves."""

    def __init__(
        self, scene: Scene, shot: Shot, simulated: bool, band_percent: tuple[float, float] = BAND_PERCENT
    ) -> None:
        self._scene, self._shot, self._simulated, self._band = scene, shot, simulated, band_percent
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._lines: deque[FloatArray] = deque(maxlen=LONGEST_MEMORY)
        self._levels: deque[State] = deque(maxlen=LONGEST_MEMORY)
        self._highest_percent = 0.0
        self._view: EchoView | None = None
        self._shots, self._sent, self._status = 0, -1, "running"

    @property
    def stopped(self) -> bool:
        """Whether somebody has asked for a stop."""
        return self._stop.is_set()

    def stop(self) -> None:
        """Ask for a stop after the shot that is running."""
        self._stop.set()

    def pause(self) -> None:
        """Refuse: single shots follow one another until stopped."""
        raise StoreError("an alignment is not paused. Try: stop it, and start it again.")

    def put(self, records: ShotRecords) -> None:
        """Take one single shot's records."""
        view = echo_view(self._scene, self._shot, records)
        with self._lock:
            self._shots += 1
            if view is not None:
                level = level_state(view, self._shot.capture.input_range_v)
                self._view = view
                self._lines.append(view.image_v[:, 0])
                self._levels.append(level)
                self._highest_percent = max(self._highest_percent, 100 * level["of_full_scale"])

    def end(self, status: str) -> None:
        """Say how it ended, once every output is off."""
        with self._lock:
            self._shots, self._status = self._shots + 1, status

    def poll(self) -> State | None:
        """Return the last shot's RF line and the gate over the last shots; None where nothing is new."""
        with self._lock:
            if self._shots == self._sent:
                return None
            self._sent, view, lines, status = self._shots, self._view, list(self._lines), self._status
            levels, highest_percent = list(self._levels), self._highest_percent
        state: State = {
            "mode": "align",
            "title": f"Aligning: {self._scene.title}",
            "simulated": self._simulated,
            "status": status,
            "stop_requested": self.stopped,
            "shot": len(lines) if status != "running" else self._sent,
        }
        if view is None:
            return state | {"why": "no record has arrived yet"}
        image_v = np.full((view.image_depth_m.size, LONGEST_MEMORY), np.nan)
        image_v[:, LONGEST_MEMORY - len(lines) :] = np.array(lines).T
        return state | {
            "rf": rf_state(view),
            "trend_percent": [round(100 * level["of_full_scale"], 2) for level in levels],
            "highest_percent": round(highest_percent, 2),
            "band_percent": self._band,
            "verdict": band_verdict(levels[-1], self._band),
            "level": levels[-1],
            "image": image_state(image_v, view.image_depth_m, float(LONGEST_MEMORY), "shots"),
        }


def align(setup: Setup, port: int, announce: Callable[[str], None], band: tuple[float, float] = BAND_PERCENT) -> int:
    """Repeat single tracking shots and show them until stopped from the page or by Ctrl-C; outputs are off after each.

    Returns the number of shots. ``setup`` as ``without_pushing`` returns it; ``announce`` gets the page's address;
    ``band``: share of full scale in which the echo is to be, in percent.
    """
    source = AlignSource(setup.scene.scene, setup.plan.shots[0], setup.bench.bench.simulated, band)
    page = LivePage(source, port)
    server = threading.Thread(target=page.serve, daemon=True)
    server.start()
    announce(page.address)
    shots, status = 0, "failed"
    try:
        with open_bench(setup.scene.scene, setup.bench.bench, setup.plan.roles) as bench:
            while not source.stopped:
                start_s = time.monotonic()
                source.put(_single_shot(setup.plan, bench))
                shots += 1
                time.sleep(max(0.0, SHOT_PERIOD_S - (time.monotonic() - start_s)))
        status = "aborted"
    except KeyboardInterrupt:
        status = "aborted"
        raise
    finally:
        source.end(status)
        page.close(grace_s=1.0)
        server.join(5.0)
    return shots


def _single_shot(plan: Plan, bench: Bench) -> ShotRecords:
    with contextlib.closing(acquire(plan, bench)) as events:
        blocks = [event.block for event in events if isinstance(event, ShotBlock)]
    return assemble(blocks, plan.shots[0])
