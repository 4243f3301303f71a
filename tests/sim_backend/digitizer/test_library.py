"""The ATSApi function table: codes for misuse, both acquisition modes, headers, time stamps, clipping."""

import ctypes
from ctypes import byref, c_int32, c_long, c_uint8, c_uint32, c_uint64, c_void_p

import numpy as np
import pytest

from sim_backend.digitizer.board import Board, BoardSettings, Input, Latencies, is_clipped, words
from sim_backend.digitizer.boards import BOARDS
from sim_backend.settings import Instruments, SimulationSettings
from sim_backend.world import World

WIRING = [("master.output", "tracking_train.trigger", 5e-9), ("tracking_train.output", "digitizer.trigger", 5e-9)]
BOARD = 0x460
SAMPLES, RECORDS, PER_BUFFER = 256, 12, 4


class Ramps:
    """Every record is another ramp, in volts; ``gain`` above 1 clips."""

    def __init__(self, gain=0.5):
        self.gain = gain

    def record_volts(self, tonebursts, pulses, capture):
        record = capture.first_record + np.arange(capture.first_sample_ps.size)[:, None]
        return self.gain * np.sin(0.01 * np.arange(capture.samples) + record)


def world_of(acoustics=None, **instruments):
    settings = SimulationSettings(instruments=Instruments(**instruments))
    return World(settings, WIRING, acoustics or Ramps())


def loaded(world, pre=0, samples=SAMPLES, delay=100, count=RECORDS):
    library = world.alazar_library()
    answers = [
        library.AlazarSetCaptureClock(BOARD, 1, 0x24, 0, 0),
        library.AlazarInputControl(BOARD, 1, 2, 9, 2),
        library.AlazarSetBWLimit(BOARD, 1, 0),
        library.AlazarInputControl(BOARD, 2, 2, 9, 2),
        library.AlazarSetTriggerOperation(BOARD, 0, 0, 2, 1, 166, 1, 3, 1, 128),
        library.AlazarSetExternalTrigger(BOARD, 2, 0),
        library.AlazarSetTriggerDelay(BOARD, delay),
        library.AlazarSetTriggerTimeOut(BOARD, 0),
        library.AlazarConfigureAuxIO(BOARD, 0, 0),
        library.AlazarSetRecordSize(BOARD, pre, samples - pre),
        library.AlazarSetRecordCount(BOARD, count),
    ]
    assert answers == [512] * 11
    return library


def fire(world, pulses=RECORDS, rate_hz=5000):
    train, master = world.connect("tracking_train"), world.connect("master")
    train.write(f"*RST;:OUTP:LOAD INF;:FUNC PULS;:FREQ {rate_hz};:PULS:WIDT 1E-5;:VOLT:HIGH 4;LOW 0")
    train.write(f"TRIG:SOUR EXT;:BURS:NCYC {pulses};STAT 1;:OUTP 1")
    master.write(
        "*RST;:OUTP:LOAD INF;:FUNC PULS;:PULS:WIDT 1E-5;:VOLT:HIGH 4;LOW 0;:TRIG:SOUR BUS;:BURS:STAT 1;:OUTP 1"
    )
    master.write("*TRG")
    train.write("SYST:ERR?")
    assert train.read() == '+0,"No error"'


def buffer_of(size):
    memory = (c_uint8 * (size + 64))()
    address = ctypes.addressof(memory)
    return memory, address + -address % 64


def single_port(world, pre=0, pulses=RECORDS):
    library = loaded(world, pre=pre)
    assert library.AlazarStartCapture(BOARD) == 512
    fire(world, pulses)
    for _ in range(100):
        if not library.AlazarBusy(BOARD):
            break
        world.clock.sleep(1e-3)
    records = []
    _memory, address = buffer_of(2 * (SAMPLES + 16))
    for record in range(1, RECORDS + 1):
        assert library.AlazarRead(BOARD, 1, c_void_p(address), 2, c_long(record), -pre, SAMPLES) == 512
        records.append(ctypes.string_at(address, 2 * SAMPLES))
    return library, b"".join(records)


def auto_dma(world, headers=False, buffers=2, channels=1, flags=0x1):
    library = loaded(world)
    flags |= 0x8 if headers else 0
    answer = library.AlazarBeforeAsyncRead(BOARD, channels, c_long(0), SAMPLES, PER_BUFFER, RECORDS, flags)
    assert answer == 512
    size = (2 * SAMPLES + 16 * headers) * PER_BUFFER * bin(channels).count("1")
    memories = [buffer_of(size) for _ in range(buffers)]
    for _, address in memories:
        assert library.AlazarPostAsyncBuffer(BOARD, address, size) == 512
    assert library.AlazarStartCapture(BOARD) == 512
    fire(world)
    data = []
    for turn in range(RECORDS // PER_BUFFER):
        address = memories[turn % buffers][1]
        assert library.AlazarWaitAsyncBufferComplete(BOARD, c_void_p(address), 1000) == 512
        data.append(ctypes.string_at(address, size))
        assert library.AlazarPostAsyncBuffer(BOARD, address, size) == 512
    assert library.AlazarAbortAsyncRead(BOARD) == 512
    return library, b"".join(data)


def test_auto_dma_and_single_port_give_the_same_bytes():
    assert auto_dma(world_of())[1] == single_port(world_of())[1]


def test_npt_mode_gives_the_same_bytes_for_one_channel():
    assert auto_dma(world_of(), flags=0x201)[1] == auto_dma(world_of())[1]


def test_the_same_messages_give_the_same_bytes():
    assert auto_dma(world_of(), headers=True)[1] == auto_dma(world_of(), headers=True)[1]


def test_words_are_left_justified_14_bit_codes():
    words = np.frombuffer(single_port(world_of())[1], "<u2").reshape(RECORDS, SAMPLES)
    assert not np.any(words & 3)
    volts = 0.8 * ((words >> 2) - 8191.5) / 8191.5
    expected = 0.5 * np.sin(0.01 * np.arange(SAMPLES) + np.arange(RECORDS)[:, None])
    assert np.max(np.abs(volts - expected)) <= 0.5 * 0.8 / 8191.5 * (1 + 1e-9)


def test_an_edge_into_1_megohm_has_twice_the_voltage_of_50_ohm():
    settings, volts = BoardSettings(BOARDS["ATS460"]), np.array([-0.3, 0.0, 0.2])
    plain = words(2 * volts, Input(0.8), settings)
    assert np.array_equal(words(volts, Input(0.8, impedance=1), settings), plain)
    assert not np.array_equal(words(volts, Input(0.8), settings), plain)
    assert is_clipped(0.41, Input(0.8, impedance=1))
    assert not is_clipped(0.41, Input(0.8))


def test_two_channels_alternate_record_by_record_and_the_unconnected_one_is_flat():
    words = np.frombuffer(auto_dma(world_of(), channels=3)[1], "<u2").reshape(RECORDS, 2, SAMPLES)
    one = np.frombuffer(auto_dma(world_of())[1], "<u2").reshape(RECORDS, SAMPLES)
    assert np.array_equal(words[:, 0], one)
    assert np.all(words[:, 1] == 8192 << 2)


def test_headers_carry_record_number_and_time_stamp():
    _library, data = auto_dma(world_of(), headers=True)
    rows = np.frombuffer(data, np.uint8).reshape(RECORDS, 16 + 2 * SAMPLES)
    header = rows[:, :16].copy().view("<u4").astype(np.int64)
    count = header[:, 2] | (header[:, 3] & 0xFF) << 32
    assert np.array_equal(header[:, 1] & 0xFFFFFF, np.arange(RECORDS))
    assert np.all(header[:, 1] >> 24 == 7)
    # Two samples a count at 100 MS/s: 200 us are 10 000 counts.
    assert np.all(np.diff(count) == 10_000)
    assert np.all(header[:, 3] >> 11 & 0x7F == 0x24)
    assert rows[:, 16:].tobytes() == auto_dma(world_of())[1]


def test_single_port_time_stamps_count_from_the_start():
    world = world_of()
    start_ps = world.clock.now_ps
    library, _ = single_port(world)
    stamp, values = c_uint64(), []
    for record in range(1, RECORDS + 1):
        assert library.AlazarGetTriggerTimestamp(BOARD, record, byref(stamp)) == 512
        values.append(stamp.value)
    # In sample clock periods: 200 us are 20 000 of 10 ns.
    assert set(np.diff(values)) == {20_000}
    since_start_ps = world.triggers(world.clock.now_ps).tick_ps - start_ps
    assert values == (since_start_ps // 20_000 * 2).tolist()


def test_time_stamps_reset_once_count_on_through_later_captures():
    world = world_of()
    library = loaded(world, count=1)
    assert library.AlazarResetTimeStamp(BOARD, 0) == 512
    reset_ps, stamp, counts = world.clock.now_ps, c_uint64(), []
    for _ in range(2):
        library.AlazarStartCapture(BOARD)
        fire(world)
        world.clock.sleep(0.1)
        library.AlazarGetTriggerTimestamp(BOARD, 1, byref(stamp))
        counts.append((stamp.value, (int(world.triggers(world.clock.now_ps).tick_ps[0]) - reset_ps) // 20_000 * 2))
    assert counts[0][0] == counts[0][1]
    assert counts[1][0] == counts[1][1] > counts[0][0] + 10_000_000


def test_pre_trigger_moves_the_record_and_not_the_trigger():
    first_world, second_world = world_of(), world_of()
    single_port(first_world, pre=64)
    single_port(second_world)
    first = [world.triggers(world.clock.now_ps).first_sample_ps[0] for world in (first_world, second_world)]
    assert first[1] - first[0] == 64 * 10_000


@pytest.mark.parametrize(("gain", "status"), [(0.79, 0), (0.9, 2)])
def test_clipping_shows_in_the_status(gain, status):
    library, data = single_port(world_of(Ramps(gain)))
    assert library.AlazarGetStatus(BOARD) == status
    assert (np.frombuffer(data, "<u2").max() == 16383 << 2) == (status == 2)


def test_volts_beyond_the_range_get_the_first_or_last_code():
    volts = 0.8 * np.array([-1.0, -1.0 - 1 / 8191, -2.0, 1.0, 1.0 + 1 / 8191, 2.0])
    assert (words(volts, Input(), BoardSettings()) >> 2).tolist() == [0, 0, 0, 16383, 16383, 16383]


def test_abort_ends_the_running_capture_only():
    board = Board(Latencies(0, 0))
    for begin_ps in (0, 100, 200):
        board.arm(begin_ps, BoardSettings())
        board.stop(begin_ps + 50)
    assert [(arming.start_ps, arming.stop_ps) for arming in board.armings] == [(0, 50), (100, 150), (200, 250)]
    board.stop(1000)
    assert board.armings[-1].stop_ps == 250


def test_signed_format_is_twos_complement():
    world = world_of()
    library = loaded(world)
    assert library.AlazarSetParameter(BOARD, 0, 0x10000041, 1) == 512
    library.AlazarStartCapture(BOARD)
    fire(world)
    world.clock.sleep(1.0)
    _memory, address = buffer_of(2 * SAMPLES)
    library.AlazarRead(BOARD, 1, address, 2, 1, 0, SAMPLES)
    signed = np.frombuffer(ctypes.string_at(address, 2 * SAMPLES), "<i2") >> 2
    expected = 0.5 * np.sin(0.01 * np.arange(SAMPLES))
    assert np.max(np.abs((signed + 0.5) / 8191.5 * 0.8 - expected)) <= 0.5 * 0.8 / 8191.5 * (1 + 1e-9)


def test_a_1_megohm_input_doubles_the_voltage():
    world = world_of(Ramps(0.5))
    library = loaded(world)
    library.AlazarInputControl(BOARD, 1, 2, 9, 1)
    library.AlazarStartCapture(BOARD)
    fire(world)
    world.clock.sleep(1.0)
    assert library.AlazarGetStatus(BOARD) == 2


REFUSED = [
    ("AlazarSetCaptureClock", (1, 0x21, 0, 0), 513),
    ("AlazarSetCaptureClock", (7, 0x24, 0, 0), 513),
    ("AlazarSetCaptureClock", (1, 0x24, 2, 0), 513),
    ("AlazarInputControl", (1, 3, 9, 2), 513),
    ("AlazarInputControl", (1, 2, 99, 2), 513),
    ("AlazarInputControl", (1, 2, 15, 2), 513),
    ("AlazarInputControl", (1, 2, 9, 4), 513),
    ("AlazarInputControl", (5, 2, 9, 2), 561),
    ("AlazarSetBWLimit", (1, 2), 513),
    ("AlazarSetTriggerOperation", (0, 0, 2, 1, 256, 1, 3, 1, 128), 513),
    ("AlazarSetTriggerOperation", (7, 0, 2, 1, 166, 1, 3, 1, 128), 513),
    ("AlazarSetTriggerOperation", (0, 0, 4, 1, 166, 1, 3, 1, 128), 513),
    ("AlazarSetTriggerOperation", (0, 0, 2, 3, 166, 1, 3, 1, 128), 513),
    ("AlazarSetTriggerOperation", (0, 0, 2, 1, 166, 0, 3, 1, 128), 513),
    ("AlazarSetExternalTrigger", (2, 2), 513),
    ("AlazarSetTriggerDelay", (10_000_000,), 513),
    ("AlazarConfigureAuxIO", (3, 0), 513),
    ("AlazarResetTimeStamp", (2,), 513),
    ("AlazarSetRecordSize", (0, 112), 536),
    ("AlazarSetRecordSize", (0, 250), 536),
    ("AlazarSetRecordSize", (32, 224), 536),
    ("AlazarSetRecordSize", (256, 0), 536),
    ("AlazarSetRecordSize", (0, 1 << 25), 536),
    ("AlazarSetRecordCount", (0,), 536),
    ("AlazarSetRecordCount", (300_000,), 536),
    ("AlazarSetParameter", (0, 0x10000043, 1), 533),
    ("AlazarSetTriggerTimeOut", (100,), 533),
    ("AlazarGetParameter", (0, 0x19999999, byref(c_long())), 533),
    ("AlazarGetParameter", (0, 0x10000009, None), 531),
    ("AlazarQueryCapability", (0x19999999, 0, byref(c_uint32())), 533),
    ("AlazarGetMaxRecordsCapable", (0, byref(c_uint32())), 536),
    ("AlazarBeforeAsyncRead", (0, 0, SAMPLES, 4, 12, 1), 561),
    ("AlazarBeforeAsyncRead", (1, 0, 120, 4, 12, 1), 536),
    ("AlazarBeforeAsyncRead", (1, -64, SAMPLES, 4, 12, 1), 567),
    ("AlazarBeforeAsyncRead", (1, 0, SAMPLES, 0, 12, 1), 584),
    ("AlazarBeforeAsyncRead", (1, 0, SAMPLES, 5, 12, 1), 584),
    ("AlazarBeforeAsyncRead", (1, 0, SAMPLES, 8192, 8192, 1), 536),
    ("AlazarBeforeAsyncRead", (1, 0, SAMPLES, 4, 12, 0x801), 533),
    ("AlazarBeforeAsyncRead", (1, 0, SAMPLES, 4, 12, 0x209), 533),
    ("AlazarPostAsyncBuffer", (64, 4096), 556),
    ("AlazarWaitAsyncBufferComplete", (64, 10), 573),
    ("AlazarGetTriggerTimestamp", (1, byref(c_uint64())), 513),
    ("AlazarRead", (1, 64, 2, 1, 0, SAMPLES), 513),
]


@pytest.mark.parametrize(("function", "arguments", "code"), REFUSED)
def test_misuse_is_refused_with_its_code_and_changes_nothing(function, arguments, code):
    world = world_of()
    library = loaded(world)
    before = world.board.settings
    assert getattr(library, function)(BOARD, *arguments) == code
    assert world.board.settings == before


@pytest.mark.parametrize(("function", "arguments", "code"), REFUSED)
def test_a_wrong_handle_is_refused_first(function, arguments, code):
    assert getattr(loaded(world_of()), function)(0, *arguments) == 572


def test_auto_dma_needs_the_dual_port_memory():
    library = loaded(world_of(dual_port_memory=False))
    options = c_uint32()
    assert library.AlazarQueryCapability(BOARD, 0x10000037, 0, byref(options)) == 512
    assert not options.value & 4
    assert library.AlazarBeforeAsyncRead(BOARD, 1, 0, SAMPLES, PER_BUFFER, RECORDS, 1) == 533


def test_old_fpga_holds_1000_single_port_records():
    library = loaded(world_of(fpga_version=18))
    most = c_uint32()
    assert library.AlazarGetMaxRecordsCapable(BOARD, SAMPLES, byref(most)) == 512
    assert most.value == 1000
    assert library.AlazarSetRecordCount(BOARD, 1000) == 512
    assert library.AlazarSetRecordCount(BOARD, 1001) == 607
    assert library.AlazarGetTriggerTimestamp(BOARD, 1001, byref(c_uint64())) == 604


def started(world, buffers=2):
    library = loaded(world, count=1)
    assert library.AlazarBeforeAsyncRead(BOARD, 1, 0, SAMPLES, PER_BUFFER, RECORDS, 1) == 512
    memories = [buffer_of(2 * SAMPLES * PER_BUFFER) for _ in range(buffers)]
    for _, address in memories:
        assert library.AlazarPostAsyncBuffer(BOARD, address, 2 * SAMPLES * PER_BUFFER) == 512
    assert library.AlazarStartCapture(BOARD) == 512
    return library, memories


def test_buffers_are_refused_with_their_codes():
    library, memories = started(world_of())
    size = 2 * SAMPLES * PER_BUFFER
    _memory, address = buffer_of(2 * size)
    refused = {
        (0, size): 531,
        (memories[0][1], size): 583,
        (address + 2, size): 537,
        (address, 0): 536,
        (address, 4 * 1024 * 1024): 536,
        (address, size - 2): 581,
    }
    assert {call: library.AlazarPostAsyncBuffer(BOARD, *call) for call in refused} == refused
    assert library.AlazarWaitAsyncBufferComplete(BOARD, 0, 1) == 531
    assert library.AlazarWaitAsyncBufferComplete(BOARD, address, 1) == 573
    assert library.AlazarWaitAsyncBufferComplete(BOARD, memories[1][1], 1) == 518
    assert library.AlazarBeforeAsyncRead(BOARD, 1, 0, SAMPLES, PER_BUFFER, RECORDS, 1) == 518
    assert library.AlazarGetTriggerTimestamp(BOARD, 1, byref(c_uint64())) == 518


def test_waiting_without_triggers_times_out_after_the_given_time():
    world = world_of()
    library, memories = started(world)
    before_s = world.clock.now_s()
    assert library.AlazarWaitAsyncBufferComplete(BOARD, memories[0][1], 250) == 579
    assert world.clock.now_s() - before_s == pytest.approx(0.25, abs=1e-12)
    fire(world)
    assert library.AlazarWaitAsyncBufferComplete(BOARD, memories[0][1], 250) == 512


def test_waiting_before_the_start_times_out():
    library = loaded(world_of())
    library.AlazarBeforeAsyncRead(BOARD, 1, 0, SAMPLES, PER_BUFFER, RECORDS, 1)
    _memory, address = buffer_of(2 * SAMPLES * PER_BUFFER)
    library.AlazarPostAsyncBuffer(BOARD, address, 2 * SAMPLES * PER_BUFFER)
    assert library.AlazarWaitAsyncBufferComplete(BOARD, address, 5) == 579


def test_records_without_a_buffer_overflow_the_memory():
    world = world_of(samples_per_channel=1024)
    library, memories = started(world, buffers=1)
    fire(world)
    assert library.AlazarWaitAsyncBufferComplete(BOARD, memories[0][1], 100) == 512
    # Memory holds three records of 256 + 16 samples; eight more come in.
    world.clock.sleep(1.0)
    assert library.AlazarPostAsyncBuffer(BOARD, memories[0][1], 2 * SAMPLES * PER_BUFFER) == 512
    assert library.AlazarWaitAsyncBufferComplete(BOARD, memories[0][1], 100) == 582
    assert library.AlazarAbortAsyncRead(BOARD) == 512
    assert not world.board.running


def test_buffer_counts_follow_the_records():
    world = world_of()
    library, memories = started(world)
    fire(world)
    world.clock.sleep(1e-3)

    def parameter(number):
        value = c_int32()
        assert library.AlazarGetParameter(BOARD, 0, number, byref(value)) == 512
        return value.value

    # The train is 2.4 ms long; the query of its error queue took one, the sleep another: ten records are in.
    assert parameter(0x10000045) == 10
    assert [parameter(number) for number in (0x10000050, 0x10000051, 0x10000052)] == [2, 2, 0]
    library.AlazarWaitAsyncBufferComplete(BOARD, memories[0][1], 100)
    assert [parameter(number) for number in (0x10000050, 0x10000051, 0x10000052)] == [1, 1, 0]


def test_abort_ends_a_capture_without_triggers():
    world = world_of()
    library = loaded(world)
    library.AlazarStartCapture(BOARD)
    assert library.AlazarBusy(BOARD) == 1
    assert world.board.running
    assert library.AlazarAbortCapture(BOARD) == 512
    assert library.AlazarBusy(BOARD) == 0
    assert not world.board.running


def test_after_abort_the_records_of_a_partial_capture_can_be_read():
    world = world_of()
    library = loaded(world)
    library.AlazarStartCapture(BOARD)
    fire(world, pulses=5)
    world.clock.sleep(1.0)
    assert library.AlazarBusy(BOARD) == 1
    library.AlazarAbortCapture(BOARD)
    _memory, address = buffer_of(2 * SAMPLES)
    answers = [library.AlazarRead(BOARD, 1, address, 2, record, 0, SAMPLES) for record in (5, 6)]
    assert answers == [512, 539]


# A pulse of 4 V, on a scale on which 127 steps are 5 V: 229.6.
@pytest.mark.parametrize(("level", "accepted"), [(128 + 127 * 39 // 50, RECORDS), (229, RECORDS), (230, 0)])
def test_a_trigger_must_reach_the_programmed_level(level, accepted):
    world = world_of()
    library = loaded(world)
    library.AlazarSetTriggerOperation(BOARD, 0, 0, 2, 1, level, 1, 3, 1, 128)
    library.AlazarStartCapture(BOARD)
    fire(world)
    world.clock.sleep(1.0)
    captured = c_int32()
    library.AlazarGetParameter(BOARD, 0, 0x10000045, byref(captured))
    assert captured.value == accepted


def test_the_board_reports_its_identity():
    library = world_of().alazar_library()
    samples, bits, major, minor, revision = c_uint32(), c_uint8(), c_uint8(), c_uint8(), c_uint8()
    assert library.AlazarGetBoardBySystemID(1, 1) == BOARD
    assert library.AlazarGetBoardBySystemID(1, 2) is None
    assert library.AlazarGetBoardKind(c_void_p(BOARD)) == 7
    assert library.AlazarGetChannelInfo(BOARD, byref(samples), byref(bits)) == 512
    assert (samples.value, bits.value) == (8_388_608, 14)
    assert library.AlazarGetSDKVersion(byref(major), byref(minor), byref(revision)) == 512
    assert (major.value, minor.value, revision.value) == (5, 8, 2)
