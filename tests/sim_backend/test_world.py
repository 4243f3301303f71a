"""The simulated bench as a whole: programmed through its wires, judged by what reaches transducer and digitizer."""

import ctypes

import numpy as np
import pytest

from sim_backend.digitizer.boards import BOARDS
from sim_backend.settings import SimulationSettings, Specimen
from sim_backend.world import Silence, World

FIG_2 = [
    ("master.output", "burst_train.trigger", 5e-9),
    ("master.output", "tracking_train.trigger", 5e-9),
    ("burst_train.output", "toneburst.trigger", 5e-9),
    ("tracking_train.output", "digitizer.trigger", 5e-9),
    ("digitizer.aux", "tracking_pulser.trigger", 5e-9),
    ("toneburst.output", "transducer.drive", 10e-9),
    ("tracking_pulser.output", "transducer.drive", 10e-9),
]
BOARD, SAMPLES = 0x460, 256
TTL = "*RST;:OUTP:LOAD INF;:FUNC PULS;:FREQ {rate};:PULS:WIDT 1E-5;:VOLT:HIGH 4;LOW 0"
TRAIN = TTL + ";:TRIG:SOUR EXT;DEL {delay};:BURS:NCYC {count};STAT 1;:OUTP 1"
BURST = "*RST;:FREQ {carrier};:VOLT 1;:TRIG:SOUR EXT;:BURS:NCYC {cycles};STAT 1;:OUTP 1"
TONEBURST = BURST.format(carrier=3e6, cycles=600)
MASTER = TTL.format(rate=1000) + ";:TRIG:SOUR BUS;:BURS:STAT 1;:OUTP 1"


class Counting:
    """Volts encode record number and number of calls; the displacement encodes the time."""

    def __init__(self):
        self.captures = []

    def record_volts(self, tonebursts, pulses, capture):
        self.captures.append(capture)
        record = np.arange(capture.first_sample_ps.size)[:, None]
        return 1e-4 * record + 1e-2 * len(self.captures) + np.zeros(capture.samples)

    def focus_displacement_m(self, tonebursts, time_ps, origin_ps, *, index=0):
        return (time_ps - origin_ps) * 1e-12


class Bench:
    """A world with its wires and its digitizer, programmed for 20 bursts and a delayed train of pulses."""

    def __init__(self, wiring=FIG_2, world=None):
        self.acoustics = Counting()
        self.world = world or World(SimulationSettings(), wiring, self.acoustics)
        self.library = self.world.alazar_library()

    def send(self, role, message):
        wire = self.world.connect(role)
        wire.write(message)
        wire.write("SYST:ERR?")
        assert wire.read() == '+0,"No error"'

    def program(self, pulses=40, delay=300e-6, bursts=20, toneburst=TONEBURST):
        self.send("tracking_pulser", BURST.format(carrier=9e6, cycles=3))
        self.send("tracking_train", TRAIN.format(rate=4000, delay=delay, count=pulses))
        self.send("toneburst", toneburst)
        self.send("burst_train", TRAIN.format(rate=100, delay=0, count=bursts))
        self.send("master", MASTER)

    def arm(self, records=40, per_buffer=10):
        board = self.library
        board.AlazarSetCaptureClock(BOARD, 1, 0x24, 0, 0)
        board.AlazarInputControl(BOARD, 1, 2, 9, 2)
        board.AlazarSetTriggerOperation(BOARD, 0, 0, 2, 1, 166, 1, 3, 1, 128)
        board.AlazarSetTriggerDelay(BOARD, 8000)
        board.AlazarSetRecordSize(BOARD, 0, SAMPLES)
        assert board.AlazarBeforeAsyncRead(BOARD, 1, 0, SAMPLES, per_buffer, records, 1) == 512
        self.buffer = (ctypes.c_uint8 * (2 * SAMPLES * per_buffer + 32))()
        self.address = ctypes.addressof(self.buffer) + -ctypes.addressof(self.buffer) % 32
        self.size = 2 * SAMPLES * per_buffer
        assert board.AlazarPostAsyncBuffer(BOARD, self.address, self.size) == 512
        assert board.AlazarStartCapture(BOARD) == 512

    def next_words(self, timeout_ms=100):
        answer = self.library.AlazarWaitAsyncBufferComplete(BOARD, self.address, timeout_ms)
        if answer != 512:
            return None
        words = np.frombuffer(ctypes.string_at(self.address, self.size), "<u2").reshape(-1, SAMPLES)
        self.library.AlazarPostAsyncBuffer(BOARD, self.address, self.size)
        return words

    def all_off(self):
        for role in self.world.outputs_on():
            self.send(role, "OUTP 0")

    def fire(self):
        """Return the time of the master's edge."""
        self.world.connect("master").write("*TRG")
        return self.world.clock.now_ps + 100_000


def shot(wiring=FIG_2, **programmed):
    """Return an armed and programmed bench that was fired, and the time of the master's edge."""
    bench = Bench(wiring)
    bench.arm()
    bench.program(**programmed)
    return bench, bench.fire()


def test_twenty_bursts_at_100_hz_and_a_delayed_train_start_from_one_edge():
    bench, edge_ps = shot()
    tonebursts, pulses, ignored = bench.world.emissions()
    # Cables 5 + 5 + 10 ns and two generators of 100 ns.
    assert np.array_equal(tonebursts.onset_ps, edge_ps + 220_000 + 10_000_000_000 * np.arange(20))
    assert np.all(tonebursts.end_ps - tonebursts.onset_ps == 200_000_000)
    # 5 + 5 + 5 + 10 ns, two generators and t_d; the digitizer's clock adds less than a sample.
    late_ps = pulses.onset_ps - (edge_ps + 225_000 + 300_000_000 + 250_000_000 * np.arange(40))
    assert np.all((late_ps >= 0) & (late_ps < 10_000))
    assert set(ignored.values()) == {0}


def test_records_follow_their_trigger_by_the_trigger_delay_on_the_same_clock():
    bench, edge_ps = shot()
    assert bench.next_words() is not None
    (capture,) = bench.acoustics.captures
    first_ps = capture.first_sample_ps
    assert np.all(first_ps % 10_000 == 0)
    since_trigger_ps = first_ps - (edge_ps + 110_000 + 300_000_000 + 250_000_000 * np.arange(40))
    assert np.all((since_trigger_ps >= 80_000_000) & (since_trigger_ps < 80_010_000))
    assert (capture.origin_ps, capture.samples, capture.sample_period_ps) == (edge_ps, SAMPLES, 10_000)


def test_the_tracking_pulse_waits_for_the_trigger_delay_if_the_trigger_output_does():
    onset_ps, first_ps = {}, {}
    for waits in (False, True):
        settings = SimulationSettings.model_validate({"instruments": {"aux_waits_for_trigger_delay": waits}})
        acoustics = Counting()
        bench = Bench(world=World(settings, FIG_2, acoustics))
        bench.arm()
        bench.program()
        bench.fire()
        assert bench.next_words() is not None
        onset_ps[waits], first_ps[waits] = bench.world.emissions()[1].onset_ps, acoustics.captures[0].first_sample_ps
    # 8000 samples of 10 ns, as armed.
    np.testing.assert_array_equal(onset_ps[True] - onset_ps[False], 80_000_000)
    np.testing.assert_array_equal(first_ps[True], first_ps[False])


def test_triggers_that_arrive_while_a_burst_runs_are_ignored_and_counted():
    bench, _ = shot(toneburst=BURST.format(carrier=1e3, cycles=15))
    tonebursts, _, ignored = bench.world.emissions()
    # Each burst lasts 15 ms, so that every second trigger of 10 ms finds it running.
    assert (tonebursts.onset_ps.size, ignored["toneburst"]) == (10, 10)


def test_a_second_master_pulse_during_the_trains_is_ignored():
    bench = Bench()
    bench.arm(records=80)
    bench.program(pulses=80)
    bench.fire()
    bench.fire()
    tonebursts, pulses, ignored = bench.world.emissions()
    assert (tonebursts.onset_ps.size, pulses.onset_ps.size) == (20, 80)
    assert (ignored["burst_train"], ignored["tracking_train"]) == (1, 1)


def test_triggers_during_a_record_are_ignored_and_do_not_fire_the_pulser():
    bench = Bench()
    bench.arm(records=20)
    bench.library.AlazarAbortAsyncRead(BOARD)
    bench.library.AlazarSetTriggerDelay(BOARD, 30_000)
    bench.library.AlazarSetRecordSize(BOARD, 0, SAMPLES)
    bench.library.AlazarBeforeAsyncRead(BOARD, 1, 0, SAMPLES, 10, 20, 1)
    bench.library.AlazarStartCapture(BOARD)
    bench.program(pulses=40)
    bench.fire()
    _, pulses, ignored = bench.world.emissions()
    assert (pulses.onset_ps.size, ignored["digitizer"]) == (20, 20)


@pytest.mark.parametrize("missing", range(len(FIG_2)))
def test_an_unwired_instrument_is_not_triggered(missing):
    bench, _ = shot(FIG_2[:missing] + FIG_2[missing + 1 :])
    tonebursts, pulses, _ = bench.world.emissions()
    tracks = missing not in (1, 3, 4, 6)
    assert tonebursts.onset_ps.size == (0 if missing in (0, 2, 5) else 20)
    assert pulses.onset_ps.size == (40 if tracks else 0)
    assert (bench.next_words() is None) == (missing in (1, 3))


def test_switching_an_output_off_cuts_its_train_and_keeps_complete_records():
    bench, _ = shot()
    first = bench.next_words()
    bench.send("tracking_pulser", "OUTP 0")
    pulses = bench.world.emissions()[1]
    assert np.all(pulses.onset_ps < bench.world.clock.now_ps)
    assert pulses.onset_ps.size < 40
    second = bench.next_words()
    # The physics was asked again; the volts that it gives by then would show in the first records too.
    assert len(bench.acoustics.captures) == 2
    assert first[0, 0] >> 2 == round(0.01 / 0.8 * 8191.5 + 8191.5)
    assert second[-1, 0] >> 2 == round((0.02 + 19e-4) / 0.8 * 8191.5 + 8191.5)


def test_complete_records_do_not_change_with_later_programming():
    bench = Bench()
    bench.arm()
    bench.library.AlazarAbortAsyncRead(BOARD)
    bench.library.AlazarSetRecordCount(BOARD, 10)
    bench.library.AlazarStartCapture(BOARD)
    bench.program()
    bench.fire()
    bench.world.clock.sleep(0.1)
    words = []
    for _ in range(2):
        assert bench.library.AlazarRead(BOARD, 1, bench.address, 2, 10, 0, SAMPLES) == 512
        words.append(ctypes.string_at(bench.address, 2 * SAMPLES))
        bench.send("toneburst", "OUTP 0")
    assert len(bench.acoustics.captures) == 2
    assert words[0] == words[1]


def test_volts_and_emissions_are_computed_once_until_an_instrument_changes():
    bench, _ = shot()
    first = bench.world.emissions()[0]
    for _ in range(4):
        assert bench.next_words() is not None
    assert bench.next_words() is None
    assert len(bench.acoustics.captures) == 1
    assert bench.world.emissions()[0] is first
    bench.send("toneburst", "OUTP 0")
    assert bench.world.emissions()[0] is not first


def test_a_running_toneburst_is_cut_at_output_off():
    bench, _ = shot(toneburst=BURST.format(carrier=1e3, cycles=15))
    bench.send("toneburst", "OUTP 0")
    tonebursts = bench.world.emissions()[0]
    assert tonebursts.onset_ps.size == 1
    # Switched off one message after the master was fired; three generators and two cables stand before the burst.
    length_s = (tonebursts.end_ps - tonebursts.onset_ps)[0] * 1e-12
    assert length_s == pytest.approx(1e-3 - 310e-9, abs=1e-12)
    assert tonebursts.cycles[0] == pytest.approx(1e3 * length_s, rel=1e-9)


def test_a_forgotten_burst_mode_drives_without_end():
    bench, _ = shot(toneburst="*RST;:FREQ 3E6;:VOLT 1;:OUTP 1")
    tonebursts = bench.world.emissions()[0]
    assert tonebursts.onset_ps.size == 1
    assert tonebursts.end_ps[0] > bench.world.clock.now_ps
    assert bench.next_words() is not None


def test_true_displacement_is_that_at_the_pulses_arrival_and_nan_without_a_pulse():
    bench, edge_ps = shot()
    bench.world.clock.sleep(5e-3)
    bench.send("tracking_pulser", "OUTP 0")
    truth = bench.world.true_displacement_m()
    onset_ps = bench.world.emissions()[1].onset_ps
    expected = (onset_ps - edge_ps) * 1e-12 + 70e-3 / 1540
    assert truth[: onset_ps.size] == pytest.approx(expected, abs=1e-12)
    assert np.all(np.isnan(truth[onset_ps.size :]))
    assert truth.size == 40


def test_motion_times_start_at_the_first_edge_of_the_master():
    """A second edge in the middle of the trains starts nothing: time counts from the first."""
    bench, edge_ps = shot()
    bench.world.clock.sleep(3e-3)
    bench.fire()
    assert bench.next_words() is not None
    assert bench.acoustics.captures[0].origin_ps == edge_ps
    time_s = np.array([0.0, 1e-3, 2.5e-3])
    assert bench.world.true_motion_m(time_s) == pytest.approx(time_s, abs=1e-12)


def test_motion_times_of_a_second_shot_start_at_its_edge():
    """The outputs stay on between both, so that the world remembers the first edge too."""
    bench, _ = shot()
    bench.world.clock.sleep(1.0)
    bench.library.AlazarAbortAsyncRead(BOARD)
    bench.arm()
    edge_ps = bench.fire()
    assert bench.next_words() is not None
    assert bench.acoustics.captures[-1].origin_ps == edge_ps


def test_captures_keep_their_truth_with_a_bounded_history():
    bench = Bench()
    truths = []
    for _ in range(3):
        bench.arm()
        bench.program()
        bench.fire()
        while bench.next_words() is not None:
            pass
        truths.append(bench.world.true_displacement_m())
        bench.world.clock.sleep(1.0)
        bench.all_off()
        bench.library.AlazarAbortAsyncRead(BOARD)
        tonebursts, pulses, _ = bench.world.emissions()
        assert (tonebursts.onset_ps.size, pulses.onset_ps.size) == (20, 40)
    assert [bench.acoustics.captures[shot].index for shot in range(3)] == [0, 1, 2]
    for shot, truth in enumerate(truths):
        assert np.array_equal(bench.world.true_displacement_m(shot), truth)
    with pytest.raises(IndexError):
        bench.world.true_displacement_m(3)


def test_outputs_and_digitizer_report_whether_they_are_safe():
    bench = Bench()
    bench.program()
    assert set(bench.world.outputs_on().values()) == {True}
    assert not bench.world.board.running
    bench.arm()
    assert bench.world.board.running
    bench.library.AlazarAbortAsyncRead(BOARD)
    bench.all_off()
    assert not bench.world.board.running
    assert set(bench.world.outputs_on().values()) == {False}


def test_a_message_advances_the_clock_and_sleeping_takes_no_real_time():
    world = World(SimulationSettings(), FIG_2, Counting())
    world.connect("master").write("*CLS")
    world.clock.sleep(3600.0)
    assert world.clock.now_s() == pytest.approx(3600.001, abs=1e-9)


@pytest.mark.parametrize(
    ("wiring", "reason"),
    [
        ([("master.sync", "toneburst.trigger", 0.0)], "no output"),
        ([("master.output", "toneburst.gate", 0.0)], "no input"),
        (
            [("digitizer.aux", "tracking_train.trigger", 0.0), ("tracking_train.output", "digitizer.trigger", 0.0)],
            "loop",
        ),
    ],
)
def test_impossible_wiring_is_refused_at_once(wiring, reason):
    with pytest.raises(ValueError, match=reason):
        World(SimulationSettings(), wiring)


def test_the_same_messages_give_the_same_bytes_with_the_twins_own_physics():
    def words():
        bench = Bench(world=World(SimulationSettings(specimen=Specimen(), receiver={"snr_db": 20.0}), FIG_2))
        bench.arm()
        bench.program()
        bench.fire()
        return bench.next_words()

    first, second = words(), words()
    assert np.array_equal(first, second)
    assert np.ptp(first.astype(int)) > 0


def monitored(plugs, channel=2, high_v=5, settings=None):
    """Return one record of 256 samples of ``channel``, 128 of them before the trigger, in volts, after one shot."""
    bench = Bench(world=World(SimulationSettings.model_validate(settings or {}), FIG_2, Silence()))
    bench.world.plug(plugs)
    bench.program(pulses=1, delay=0, bursts=1)
    for role in ("master", "burst_train", "tracking_train"):
        bench.send(role, f"VOLT:HIGH {high_v}")
    board = bench.library
    board.AlazarSetCaptureClock(BOARD, 1, 0x24, 0, 0)
    board.AlazarInputControl(BOARD, channel, 2, 12, 2)
    board.AlazarSetTriggerOperation(BOARD, 0, 0, 2, 1, 166, 1, 3, 1, 128)
    board.AlazarSetTriggerDelay(BOARD, 0)
    board.AlazarSetRecordSize(BOARD, 128, 128)
    board.AlazarSetRecordCount(BOARD, 1)
    assert board.AlazarStartCapture(BOARD) == 512
    bench.fire()
    bench.world.clock.sleep(1e-3)
    words = (ctypes.c_uint16 * SAMPLES)()
    if board.AlazarRead(BOARD, channel, words, 2, 1, -128, SAMPLES) != 512:
        return None
    return ((np.array(words) >> 2) / 8191.5 - 1) * 4


@pytest.mark.parametrize(("name", "channel"), [("digitizer.channel_a", 1), ("digitizer.channel_b", 2)])
def test_an_output_on_a_t_piece_is_recorded_with_the_delay_of_its_cable(name, channel):
    near_v, far_v = (
        monitored([(source, name, delay_s)], channel)
        for source, delay_s in (("tracking_train.output", 105e-9), ("master.output", 250e-9))
    )
    # 5 V without load are 2.5 V at 50 ohm.
    assert np.unique(near_v.round(2)).tolist() == np.unique(far_v.round(2)).tolist() == [0.0, 2.5]
    # The train rises 5 ns before it reaches the trigger input, and 105 ns after the master.
    assert (near_v > 1).argmax() == 128 + 10
    assert (far_v > 1).argmax() == 128 + 14


def test_a_t_piece_halves_the_voltage_at_the_other_inputs():
    """At 4 V the trigger inputs behind the T piece get less than their 2.0 V."""
    plugs = [("master.output", "digitizer.channel_b", 5e-9)]
    assert monitored(plugs, high_v=4) is None
    assert monitored(plugs, high_v=5) is not None


def test_a_cable_with_exchanged_conductors_inverts_pulses_and_bursts():
    for source, extreme_v in (("master.output", 2.5), ("toneburst.output", 1 / 3)):
        upright, inverted = (monitored([(source, "digitizer.channel_b", 5e-9, flip)]) for flip in (False, True))
        assert np.abs(upright).max() == pytest.approx(extreme_v, rel=2e-3)
        np.testing.assert_allclose(inverted, -upright, atol=1e-3)


def test_a_reversed_trigger_cable_triggers_nothing():
    bench, _ = shot([(*cable, cable[1] == "burst_train.trigger") for cable in FIG_2])
    tonebursts, pulses, _ = bench.world.emissions()
    assert (tonebursts.onset_ps.size, pulses.onset_ps.size) == (0, 40)


def test_a_role_at_the_address_of_another_generator_programs_that_one():
    bench = Bench(world=World(SimulationSettings(), FIG_2, boxes={"toneburst": "master", "master": "toneburst"}))
    bench.send("toneburst", "OUTP 1")
    assert [role for role, on in bench.world.outputs_on().items() if on] == ["master"]


CLOCK_ERRORS = {
    "master": 2e-5,
    "burst_train": -1e-5,
    "toneburst": 5e-5,
    "tracking_train": 3e-5,
    "tracking_pulser": -4e-5,
    "digitizer": -2e-5,
}


def fired(instruments, acoustics=None):
    """Return a bench that has fired one shot, and the world's time of the command that fired it."""
    settings = SimulationSettings.model_validate({"instruments": instruments})
    bench = Bench(world=World(settings, FIG_2, acoustics or Counting()))
    bench.arm()
    bench.library.AlazarAbortAsyncRead(BOARD)
    bench.library.AlazarSetRecordCount(BOARD, 40)
    assert bench.library.AlazarStartCapture(BOARD) == 512
    bench.program()
    bench.send("master", MASTER + ";:TRIG:DEL 0.5")
    return bench, bench.fire() - 100_000


def stamps_of(bench):
    """Return the time stamps of the 40 records, in samples."""
    bench.world.clock.sleep(1.0)
    stamp, stamps = ctypes.c_uint64(), []
    for record in range(1, 41):
        assert bench.library.AlazarGetTriggerTimestamp(BOARD, record, ctypes.byref(stamp)) == 512
        stamps.append(stamp.value)
    return stamps


def true_edges_ps(fired_ps):
    """Return the edge of the master and those of the tracking train, from the definition of a rate error."""
    master_ps = fired_ps + 100_000 + 0.5e12 / (1 + CLOCK_ERRORS["master"])
    delay_ps, period_ps = (value / (1 + CLOCK_ERRORS["tracking_train"]) for value in (300e6, 250e6))
    # Two cables of 5 ns and the latency of the train's generator.
    return master_ps, master_ps + 110_000 + delay_ps + period_ps * np.arange(40)


def test_bursts_and_pulses_follow_the_clock_of_their_own_generator():
    bench, fired_ps = fired({"clock_error": CLOCK_ERRORS})
    tonebursts, pulses, ignored = bench.world.emissions()
    master_ps, edge_ps = true_edges_ps(fired_ps)
    burst_period_ps = 1e10 / (1 + CLOCK_ERRORS["burst_train"])
    np.testing.assert_allclose(
        tonebursts.onset_ps, master_ps + 220_000 + burst_period_ps * np.arange(20), rtol=0, atol=2
    )
    np.testing.assert_allclose(tonebursts.end_ps - tonebursts.onset_ps, 200e6 / (1 + 5e-5), rtol=0, atol=1)
    np.testing.assert_allclose(tonebursts.carrier_hz, 3e6 * (1 + 5e-5), rtol=1e-12)
    np.testing.assert_allclose(pulses.carrier_hz, 9e6 * (1 - 4e-5), rtol=1e-12)
    # The digitizer passes the trigger on at its next tick.
    since_edge_ps = pulses.onset_ps - edge_ps - 115_000
    assert np.all((since_edge_ps > -3) & (since_edge_ps < 10_003))
    assert set(ignored.values()) == {0}


def test_time_stamps_are_true_times_by_the_digitizers_clock():
    bench, fired_ps = fired({"clock_error": CLOCK_ERRORS})
    start_ps = bench.world.board.armings[-1].start_ps
    _, edge_ps = true_edges_ps(fired_ps)
    ticks = np.ceil((edge_ps - start_ps) * (1 + CLOCK_ERRORS["digitizer"]) / 10_000)
    step = BOARDS["ATS460"].samples_per_count
    np.testing.assert_array_equal(stamps_of(bench), ticks // step * step)


def test_samples_and_the_trigger_delay_follow_the_digitizers_clock():
    acoustics = Counting()
    bench, _ = fired({"clock_error": CLOCK_ERRORS}, acoustics)
    bench.world.clock.sleep(1.0)
    words = (ctypes.c_uint16 * SAMPLES)()
    assert bench.library.AlazarRead(BOARD, 1, words, 2, 1, 0, SAMPLES) == 512
    # From the pulse, 105 ns after the tick (AUX, cable 5 ns, generator 100 ns), to sample 0: 8000 samples.
    pulses = bench.world.emissions()[1]
    since_pulse_ps = acoustics.captures[0].first_sample_ps - (pulses.onset_ps - 115_000)
    np.testing.assert_allclose(since_pulse_ps, 80e6 / (1 + CLOCK_ERRORS["digitizer"]), rtol=0, atol=1)
    assert len(set(since_pulse_ps.tolist())) == 1


def test_samples_of_the_second_input_follow_the_digitizers_clock():
    """A fast clock counts 121 periods in 1.2 us: the 120 of a perfect one, and 1 % more."""
    plugs = [("tracking_train.output", "digitizer.channel_b", 1205e-9)]
    perfect, fast = (
        monitored(plugs, settings={"instruments": {"clock_error": {"digitizer": error}}}) for error in (0.0, 9e-3)
    )
    assert (fast > 1).argmax() == (perfect > 1).argmax() + 1
