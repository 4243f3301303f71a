"""Alignment with the live page: nothing pushes, single shots, the band of full scale."""

from __future__ import annotations

import http.client
import json
import threading
from urllib.parse import urlsplit

import pytest
from websockets.sync.client import connect

from hpe_rig.live.alignment import AlignSource, align, band_percent, without_pushing
from hpe_rig.live.server import LivePage
from hpe_rig.live.state import State, band_verdict
from hpe_rig.measurement.setup import prepare
from hpe_rig.scene import SettingsError


def test_alignment_opens_no_generator_that_pushes() -> None:
    setup = without_pushing(prepare("bovine-muscle"))
    assert set(setup.plan.roles) == {"master", "tracking_train", "tracking_pulser", "digitizer"}
    (shot,) = setup.plan.shots
    assert shot.toneburst is None
    assert shot.capture.record_count == 1


def test_alignment_repeats_single_shots_until_stopped_from_the_page(monkeypatch: pytest.MonkeyPatch) -> None:
    addresses: list[str] = []
    states: list[State] = []

    def look(text: str) -> None:
        addresses.append(text)
        threading.Thread(target=stop_after_some, daemon=True).start()

    def stop_after_some() -> None:
        parts = urlsplit(addresses[0])
        with connect(addresses[0].replace("http:", "ws:") + "ws", max_size=None, open_timeout=20) as viewer:
            while not states or states[-1].get("shot", 0) < 5:
                states.append(json.loads(viewer.recv(timeout=20)))
            connection = http.client.HTTPConnection("127.0.0.1", parts.port or 0, timeout=10)
            connection.request("POST", parts.path + "stop")
            assert connection.getresponse().status == 200
            connection.close()
            while states[-1]["status"] == "running":
                states.append(json.loads(viewer.recv(timeout=20)))

    close = LivePage.close
    # A busy machine may need more than the usual second to deliver the last state.
    monkeypatch.setattr(LivePage, "close", lambda page, grace_s: close(page, 60 * grace_s))
    shots = align(without_pushing(prepare("bovine-muscle")), 0, look)
    assert shots >= 5
    assert states[-1]["status"] == "aborted"
    shown = [state for state in states if "rf" in state]
    assert shown[-1]["mode"] == "align"
    assert shown[-1]["level"]["rms_mv"] > 10
    trend = shown[-1]["trend_percent"]
    assert trend[-1] == pytest.approx(100 * shown[-1]["level"]["of_full_scale"], abs=0.006)
    assert shown[-1]["highest_percent"] == pytest.approx(max(trend), abs=0.006)
    assert shown[-1]["verdict"] == "within 10 to 80 % of full scale"


def test_the_band_says_what_to_try_beyond_it() -> None:
    def said(of_full_scale: float, clipped: bool = False) -> str:
        return band_verdict({"of_full_scale": of_full_scale, "clipped": clipped}, (10.0, 80.0))

    assert said(0.05).startswith("below 10 %")
    assert said(0.5).startswith("within")
    assert said(0.9).startswith("above 80 %")
    assert said(1.0, True).startswith("clipped")
    assert band_percent("5:60") == (5.0, 60.0)
    for wrong in ("80:10", "10", "a:b", "-1:5", "0:101", "nan:5"):
        with pytest.raises(SettingsError, match="no band"):
            band_percent(wrong)


def test_an_alignment_without_records_says_so() -> None:
    setup = without_pushing(prepare("table-1"))
    source = AlignSource(setup.scene.scene, setup.plan.shots[0], simulated=True)
    state = source.poll()
    assert state is not None
    assert "no record" in state["why"]
