"""Alignment of the focus on the specimen: single tracking shots without tonebursts, repeated until stopped."""

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
from hpe_rig.bench import open_bench
from hpe_rig.live.server import LivePage
from hpe_rig.live.state import State, band_verdict, image_state, level_state, rf_state
from hpe_rig.measurement import Setup, ShotBlock, acquire
from hpe_rig.plan import Shot, check_plan, make_plan, refuse_conflicts
from hpe_rig.report import EchoView, echo_view
from hpe_rig.scene import Mistake, Scene, SettingsError
from hpe_rig.store import ShotRecords, StoreError, assemble

MAX_SHOTS = 240
"""Single shots in the M-mode image."""
SHOT_PERIOD_S = 0.05
"""Twenty single shots a second: the eye follows no more."""

BAND_PERCENT = (10.0, 80.0)
"""Range of the largest echo in the gate, % of full scale: below it bits are unused, above it echoes clip."""

VIBRATION_CHECKS = ("pulse count", "frequencies", "aliasing", "resolution", "synchronous")
"""Checks of whether a vibration can be estimated, which do not apply to a single pulse."""


def without_pushing(setup: Setup) -> Setup:
    """Return ``setup`` with one tracking pulse for each shot and no toneburst; raise ``PlanError`` if it cannot run."""
    scene = setup.scene.scene
    tracking = scene.tracking.model_copy(update={"pulse_count": 1})
    processing = scene.processing.model_copy(
        update={"frequencies_hz": None, "window_start_s": 0.0, "window_length_s": None, "synchronous": False}
    )
    acquisition = scene.acquisition.model_copy(update={"repeats": 1, "shot_period_s": None})
    sections = {"excitation": None, "tracking": tracking, "processing": processing, "acquisition": acquisition}
    single = scene.model_copy(update=sections)
    bench = setup.bench.bench
    plan = make_plan(single, bench)
    # Whether the calibration has expired is checked for the day, with the setup.
    expiry = (finding for finding in setup.findings if finding.check == "calibration")
    checked = (result for result in check_plan(single, bench, plan) if result.check not in VIBRATION_CHECKS)
    results = (*checked, *expiry)
    refuse_conflicts(results)
    return Setup(replace(setup.scene, scene=single), setup.bench, plan, results)


def band_percent(text: str) -> tuple[float, float]:
    """Return the limits in percent of full scale of a text such as 10:80; raise ``SettingsError`` for others."""
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
    """The last single shots; the acquiring thread writes them, the serving thread reads them."""

    def __init__(
        self, scene: Scene, shot: Shot, simulated: bool, band_percent: tuple[float, float] = BAND_PERCENT
    ) -> None:
        self._scene, self._shot, self._simulated, self._band = scene, shot, simulated, band_percent
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._lines: deque[FloatArray] = deque(maxlen=MAX_SHOTS)
        self._levels: deque[State] = deque(maxlen=MAX_SHOTS)
        self._highest_percent = 0.0
        self._view: EchoView | None = None
        self._version, self._sent, self._status = 0, -1, "running"

    @property
    def stopped(self) -> bool:
        """Whether a stop was requested."""
        return self._stop.is_set()

    def stop(self) -> None:
        """Request a stop after the current shot."""
        self._stop.set()

    def pause(self) -> None:
        """Raise ``StoreError``: an alignment has no pause."""
        raise StoreError("an alignment cannot be paused. Try: stop it, and start it again.")

    def put(self, records: ShotRecords) -> None:
        """Add the records of one single shot."""
        view = echo_view(self._scene, self._shot, records)
        with self._lock:
            self._version += 1
            if view is not None:
                level = level_state(view, self._shot.capture.input_range_v)
                self._view = view
                self._lines.append(view.image_v[:, 0])
                self._levels.append(level)
                self._highest_percent = max(self._highest_percent, 100 * level["of_full_scale"])

    def end(self, status: str) -> None:
        """Set the final status, once every output is off."""
        with self._lock:
            self._version, self._status = self._version + 1, status

    def poll(self) -> State | None:
        """Return the last RF line and the gate over the last shots; None without a new shot."""
        with self._lock:
            if self._version == self._sent:
                return None
            self._sent, view, lines, status = self._version, self._view, list(self._lines), self._status
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
            return state | {"why": "no record has arrived so far"}
        image_v = np.full((view.image_depth_m.size, MAX_SHOTS), np.nan)
        image_v[:, MAX_SHOTS - len(lines) :] = np.array(lines).T
        return state | {
            "rf": rf_state(view),
            "trend_percent": [round(100 * level["of_full_scale"], 2) for level in levels],
            "highest_percent": round(highest_percent, 2),
            "band_percent": self._band,
            "verdict": band_verdict(levels[-1], self._band),
            "level": levels[-1],
            "image": image_state(image_v, view.image_depth_m, float(MAX_SHOTS), "shots"),
        }


def align(setup: Setup, port: int, announce: Callable[[str], None], band: str = "10:80") -> int:
    """Repeat single tracking shots and display them until a stop from the page or Ctrl-C; return their number.

    Outputs are off after each shot, and tonebursts are omitted. ``announce`` receives the page's address, ``band`` is
    the target range of the echo in % of full scale. Raises ``PlanError`` if the single shots cannot run.
    """
    limits_percent, setup = band_percent(band), without_pushing(setup)
    source = AlignSource(setup.scene.scene, setup.plan.shots[0], setup.bench.bench.simulated, limits_percent)
    page = LivePage(source, port)
    server = threading.Thread(target=page.serve, daemon=True)
    server.start()
    announce(page.address)
    shots, status = 0, "failed"
    try:
        with open_bench(setup.scene.scene, setup.bench.bench, setup.plan.roles) as bench:
            while not source.stopped:
                start_s = time.monotonic()
                with contextlib.closing(acquire(setup.plan, bench)) as events:
                    blocks = [event.block for event in events if isinstance(event, ShotBlock)]
                source.put(assemble(blocks, setup.plan.shots[0]))
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
