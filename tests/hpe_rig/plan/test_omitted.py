"""What a scene leaves out is said, and what it does not leave out is not."""

import pytest

import hpe_rig as hpe
from hpe_rig.measurement.setup import prepare_text
from hpe_rig.scene import shipped_scenes

CHAIN = shipped_scenes()["gelatin-8"]
PLAIN = shipped_scenes()["bovine-muscle"]


def omitted(text: str) -> dict[str, str]:
    return dict(prepare_text("a", text).plan.omitted)


@pytest.mark.parametrize(
    ("text", "there", "absent"),
    [
        (CHAIN, [], ["receiver noise", "receive chain", "trigger jitter", "specimen response"]),
        (CHAIN.replace('preset = "paper"', ""), [], ["receiver noise"]),
        (CHAIN.replace('preset = "paper"', "").replace("noise_v_per", "#"), ["receiver noise"], ["receive chain"]),
        (CHAIN.replace("trigger_jitter_s = 1.0e-9", ""), ["trigger jitter"], []),
        (PLAIN, ["receive chain", "trigger jitter"], ["receiver noise"]),
        (PLAIN.replace("snr_db = 40.0", ""), ["receiver noise"], []),
    ],
)
def test_noise_chain_and_jitter_are_left_out_where_the_scene_has_none(text, there, absent):
    said = omitted(text)
    assert set(there) <= said.keys()
    assert not set(absent) & said.keys()


def test_a_prior_is_missed_only_where_something_pushes():
    free = 'harmonic = "least_squares"'
    pushed = omitted(PLAIN.replace("[processing]", f"[processing]\n{free}"))
    assert pushed["prior of media"].endswith("the peak is corrected by the prior")
    one = omitted(PLAIN.replace("[processing]", "[processing]\nfrequencies_hz = [150.0]"))
    assert one["prior of media"].endswith("from the wanted ones")
    still = omitted(shipped_scenes()["table-1"])
    assert "prior of media" not in still
    assert "generators burst_train and toneburst" in still


def test_reason_names_the_key_that_would_bring_the_noise():
    text = CHAIN.replace('preset = "paper"', "").replace("noise_v_per", "#")
    assert "simulation.receive_chain.noise_v_per_sqrt_hz" in omitted(text)["receiver noise"]
    assert "simulation.receiver.snr_db" in omitted(PLAIN.replace("snr_db = 40.0", ""))["receiver noise"]


def test_a_stored_run_says_what_the_estimator_that_is_asked_for_omits(tmp_path):
    run = hpe.measure("bovine-muscle-synchronous", path=tmp_path / "run.h5")
    assert "prior of media" not in dict(run.estimate().omitted)
    why = dict(run.estimate("cross_spectrum").omitted)["prior of media"]
    assert '"cross_spectrum"' in why
    assert "the peak is corrected by the prior" in why
