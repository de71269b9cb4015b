"""The CiA 402 profile: set-up, the state machine, what feeds its watchdog, and that nothing from outside raises."""

import math
import struct
from collections.abc import Iterable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.frames import Frame
from firmware_protocol.messages import DriveState
from firmware_protocol.scales import ANGLE_LSB_RAD, CURRENT_LSB_A
from firmware_protocol.states import HostPhase
from hil_forceps.drives.cia402 import messages as wire
from hil_forceps.drives.cia402.machine import SILENCE_NS, TRANSITIONS, Cia402
from hil_forceps.drives.cia402.messages import State
from hil_forceps.drives.cia402.objects import HOST_NODE, Cia402Config
from hil_forceps.drives.cia402.setup import SDO_TIMEOUT_NS
from hil_forceps.drives.cia402.sync_cycle import ANSWER_NS

NODE, MS = 5, 1_000_000
CONFIG = Cia402Config(NODE, 16384.0, 0.0, MS, 100 * MS)
STATUS = {state: bits for state in State for _, bits in [state.value]}


def position(counts: int, state: State, mode: int = 8) -> Frame:
    return Frame(0x180 + NODE, struct.pack("<ihb", counts, STATUS[state], mode))


def current(milliamperes: int) -> Frame:
    return Frame(0x280 + NODE, struct.pack("<i", milliamperes))


def answer(request: Frame, device_type: int = 0x20192) -> Frame:
    """What a server says that takes everything."""
    command, index, subindex = struct.unpack_from("<BHB", request.data)
    if command == 0x40:
        return Frame(0x580 + NODE, struct.pack("<BHBI", 0x43, index, subindex, device_type))
    return Frame(0x580 + NODE, struct.pack("<BHB4x", 0x60, index, subindex))


def set_up(config: Cia402Config = CONFIG) -> tuple[Cia402, list[Frame], int]:
    """Return a drive that has been set up, what was sent to it, and the next tick in ms."""
    drive = Cia402(config)
    drive.connect(0)
    sent: list[Frame] = []
    for n in range(100):
        frames = drive.poll(n * MS)
        sent += frames
        for frame in frames:
            if frame.arbitration_id == 0x600 + NODE:
                drive.receive(answer(frame), n * MS)
            if frame == wire.nmt(wire.Nmt.START, NODE):
                return drive, sent, n + 1
    raise AssertionError(drive.phase)


def tick(drive: Cia402, n: int, state: State, raw: int = 1000, counts: int = 1) -> list[Frame]:
    """What the drive says to the last SYNC, then what goes out, as the service asks for it."""
    drive.receive(position(counts, state), n * MS)
    drive.receive(current(100), n * MS)
    reference = drive.setpoint(raw)
    return ([] if reference is None else [reference]) + drive.poll(n * MS)


def ready() -> tuple[Cia402, int]:
    drive, _, n = set_up()
    drive.poll(n * MS)
    tick(drive, n + 1, State.SWITCH_ON_DISABLED)
    assert drive.phase is HostPhase.READY
    return drive, n + 2


def running() -> tuple[Cia402, int]:
    drive, n = ready()
    drive.enable()
    for state in (State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, State.SWITCHED_ON, State.OPERATION_ENABLED):
        tick(drive, n, state)
        n += 1
    assert drive.phase is HostPhase.RUNNING
    return drive, n


def controls(frames: Iterable[Frame]) -> list[int]:
    return [struct.unpack_from("<H", frame.data)[0] for frame in frames if frame.arbitration_id == 0x200 + NODE]


def test_set_up_is_one_request_at_a_time_and_ends_with_start() -> None:
    _, sent, _ = set_up()
    assert sent[0] == Frame(0x000, bytes((0x80, NODE)))
    assert sent[1] == Frame(0x605, bytes.fromhex("4000100000000000"))
    start = sent.index(Frame(0x000, bytes((0x01, NODE))))
    assert wire.sync() not in sent[:start]
    written = {struct.unpack_from("<HB", frame.data, 1): frame.data[4:] for frame in sent[2:start]}
    assert written[0x60C2, 1][0] == 1
    assert written[0x60C2, 2][0] == 0xFD  # 10^-3 s
    assert written[0x6060, 0][0] == 8
    assert written[0x1016, 1] == struct.pack("<I", HOST_NODE << 16 | 100)
    assert written[0x1A01, 1] == struct.pack("<I", 0x30D10220)


def test_the_heartbeat_is_that_of_the_host_which_the_drive_watches() -> None:
    drive, _, n = set_up(CONFIG._replace(host_node=125))
    sent = [frame for k in range(30) for frame in tick(drive, n + k, State.SWITCH_ON_DISABLED)]
    beats = [frame for frame in sent if frame.arbitration_id >= 0x700]
    assert set(beats) == {wire.heartbeat(125)}


def test_nobody_there_is_asked_again_and_again() -> None:
    drive = Cia402(CONFIG)
    drive.connect(0)
    sent = [frame for n in range(1900) for frame in drive.poll(n * MS)]
    assert drive.phase is HostPhase.IDENTIFYING
    assert len(sent) == 1 + math.ceil(1899 * MS / SDO_TIMEOUT_NS)


def test_an_answer_that_stays_away_is_refused() -> None:
    drive = Cia402(CONFIG)
    drive.connect(0)
    for n in range(1000):
        for frame in drive.poll(n * MS):
            if frame.data[:1] == b"\x40":
                drive.receive(answer(frame), n * MS)
    assert drive.phase is HostPhase.REFUSED
    assert drive.refusal == "node 5 does not answer requests for 1017h:00"


def test_an_abort_is_refused_in_words() -> None:
    drive = Cia402(CONFIG)
    drive.connect(0)
    for n in range(60):
        for frame in drive.poll(n * MS):
            if frame.data[1:4] == b"\x01\x1a\x01":
                drive.receive(Frame(0x585, b"\x80\x01\x1a\x01" + (0x06040041).to_bytes(4, "little")), n * MS)
            elif frame.arbitration_id == 0x605:
                drive.receive(answer(frame), n * MS)
    assert drive.refusal == "node 5 refuses 1A01h:01 (abort 0x06040041: it can't be mapped to a PDO)"


def test_another_device_is_refused() -> None:
    drive = Cia402(CONFIG)
    drive.connect(0)
    for n in range(3):
        for frame in drive.poll(n * MS):
            if frame.arbitration_id == 0x605:
                drive.receive(answer(frame, device_type=0x00040191), n * MS)
    assert drive.phase is HostPhase.REFUSED
    assert "no CiA 402 drive: its device type is of profile 401" in drive.refusal


@pytest.mark.parametrize(("mode", "said"), [(1, "stays in mode 1"), (None, "sends no position with SYNC")])
def test_a_drive_that_does_not_do_as_told_is_refused(mode: int | None, said: str) -> None:
    drive, _, first = set_up()
    for n in range(first, first + 520):
        if mode is not None:
            drive.receive(position(0, State.SWITCH_ON_DISABLED, mode), n * MS)
            drive.receive(current(0), n * MS)
        drive.poll(n * MS)
    assert drive.phase is HostPhase.REFUSED
    assert said in drive.refusal


def test_the_controlword_follows_the_statusword_and_the_target_is_the_measured_angle() -> None:
    drive, n = ready()
    drive.enable()
    said: list[int] = []
    targets = set()
    for k, state in enumerate(
        (State.SWITCH_ON_DISABLED, State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, State.SWITCHED_ON)
    ):
        frames = tick(drive, n + k, state, raw=(1 << 22) + k)
        said += controls(frames)
        targets |= {struct.unpack_from("<Hi", frame.data)[1] for frame in frames if frame.arbitration_id == 0x205}
    assert said == [0x06, 0x06, 0x07, 0x0F]
    assert targets == {4096}


def test_the_target_is_where_the_motor_is_when_operation_is_asked_for() -> None:
    drive, n = ready()
    drive.enable()
    states = [State.SWITCH_ON_DISABLED] * 3 + [State.READY_TO_SWITCH_ON] + [State.SWITCHED_ON] * 3
    states += [State.READY_TO_SWITCH_ON, State.SWITCHED_ON, State.SWITCHED_ON]  # it fell back once
    targets = []
    for k, state in enumerate(states):  # the motor is turned meanwhile, by hand
        frames = tick(drive, n + k, state, raw=(k + 1) << 20)
        targets += [struct.unpack_from("<Hi", frame.data)[1] for frame in frames if frame.arbitration_id == 0x205]
    assert targets == [1024, 2048, 3072, 4096, 5120, 5120, 5120, 8192, 9216, 9216]


def test_sync_goes_out_behind_the_reference() -> None:
    drive, n = running()
    frames = tick(drive, n, State.OPERATION_ENABLED)
    assert frames[0].arbitration_id == 0x205
    assert frames[-1] == wire.sync()


def test_the_hosts_heartbeat_goes_out_with_references_and_only_with_them() -> None:
    drive, n = running()
    beats = sum(wire.heartbeat(HOST_NODE) in tick(drive, n + k, State.OPERATION_ENABLED) for k in range(100))
    assert 4 <= beats <= 6
    for k in range(100, 300):  # an estimator that stalls: samples come, no reference goes
        drive.receive(position(1, State.OPERATION_ENABLED), (n + k) * MS)
        drive.receive(current(100), (n + k) * MS)
        assert drive.poll((n + k) * MS) == [wire.sync()]


def test_a_sample_is_stamped_with_the_sync_that_asked_for_it() -> None:
    drive, n = running()
    drive.take_samples()
    drive.receive(position(4096, State.OPERATION_ENABLED), n * MS - 700_000)
    drive.receive(current(-250), n * MS - 600_000)
    (sample,) = drive.take_samples()
    assert sample.stamp_ns == (n - 1) * MS
    assert sample.received_ns == n * MS - 600_000
    assert sample.theta_m * ANGLE_LSB_RAD == pytest.approx(0.5 * math.pi)
    assert sample.current * CURRENT_LSB_A == pytest.approx(-0.25)
    assert sample.state == DriveState.OPERATIONAL


@pytest.mark.parametrize("delay_ms", [1, 3, 20, 45])
def test_on_a_slow_path_samples_are_fewer_and_their_stamps_are_true(delay_ms: int) -> None:
    drive, n = running()
    drive.receive(position(1, State.OPERATION_ENABLED), n * MS)
    drive.receive(current(100), n * MS)
    drive.take_samples()
    asked: list[int] = []
    for k in range(n, n + 200):
        for sync_ms in [each for each in asked if each + delay_ms == k]:  # the counts say which SYNC is answered
            drive.receive(position(sync_ms, State.OPERATION_ENABLED), k * MS)
            drive.receive(current(100), k * MS)
        if wire.sync() in drive.poll(k * MS):
            asked.append(k)
    samples = drive.take_samples()
    assert len(samples) == len(asked) - 1 >= 200 // delay_ms - 1
    scale = 2**24 / CONFIG.counts_per_pulley_rev
    assert [sample.stamp_ns for sample in samples] == [round(sample.theta_m / scale) * MS for sample in samples]


def test_one_sync_has_one_sample() -> None:
    drive, n = running()
    drive.take_samples()
    for _ in range(3):
        drive.receive(position(1, State.OPERATION_ENABLED), n * MS)
        drive.receive(current(100), n * MS)
    assert len(drive.take_samples()) == 1
    assert drive.counters["unpaired"] == 4


def test_frames_of_two_syncs_make_no_sample() -> None:
    drive, n = running()
    drive.take_samples()
    drive.receive(position(1, State.OPERATION_ENABLED), n * MS)
    later = n + ANSWER_NS // MS
    assert wire.sync() not in drive.poll((later - 2) * MS)
    assert wire.sync() in drive.poll(later * MS)  # the current is given up
    drive.receive(current(100), later * MS)
    assert drive.take_samples() == []
    assert (drive.counters["unpaired"], drive.counters["syncs_unanswered"]) == (1, 1)


def test_a_fault_is_told_by_its_emergency_and_reset_by_one_edge() -> None:
    drive, n = running()
    drive.receive(Frame(0x085, struct.pack("<HB5x", 0x8130, 0x11)), n * MS)
    assert controls(tick(drive, n, State.FAULT)) == []
    assert drive.phase is HostPhase.FAULT
    assert drive.fault_words() == "error code 0x8130"
    drive.reset_fault()
    assert [controls(tick(drive, n + k, State.FAULT)) for k in range(1, 5)] == [[0x00], [0x80], [], []]
    tick(drive, n + 5, State.SWITCH_ON_DISABLED)
    assert drive.phase.name == "READY"


def test_disabling_takes_the_voltage_off_until_it_is_seen() -> None:
    drive, n = running()
    drive.disable()
    assert controls(tick(drive, n, State.OPERATION_ENABLED)) == [0x00]
    assert controls(tick(drive, n + 1, State.OPERATION_ENABLED)) == [0x00]
    assert controls(tick(drive, n + 2, State.SWITCH_ON_DISABLED)) == []
    assert drive.drive_state is DriveState.DISABLED


def test_a_boot_up_or_silence_is_a_lost_drive() -> None:
    drive, n = running()
    drive.receive(Frame(0x700 + NODE, b"\x00"), n * MS)
    assert drive.phase is HostPhase.DISCONNECTED
    assert drive.poll((n + 1) * MS) == []
    drive, n = running()
    drive.poll(n * MS + SILENCE_NS + 1)
    assert drive.phase is HostPhase.DISCONNECTED


@pytest.mark.parametrize("ratio", [16384.0, -16384.0, 500.0])
def test_gear_sign_and_zero_are_those_of_the_rig(ratio: float) -> None:
    drive = Cia402(CONFIG._replace(counts_per_pulley_rev=ratio, zero_counts=77.0))
    frame = drive._command(wire.Control.ENABLE_OPERATION, round(77.0 + 0.25 * ratio))
    drive._cycle.poll(0)
    drive.phase = HostPhase.RUNNING
    counts = struct.unpack_from("<Hi", frame.data)[1]
    drive.receive(position(counts, State.OPERATION_ENABLED), MS)
    drive.receive(current(200), MS)
    (sample,) = drive.take_samples()
    assert sample.theta_m * ANGLE_LSB_RAD == pytest.approx(0.5 * math.pi, abs=0.02)
    assert sample.current * CURRENT_LSB_A == pytest.approx(math.copysign(0.2, ratio))


@pytest.mark.parametrize(
    "change", [{"node": 0}, {"node": 127}, {"counts_per_pulley_rev": 0.0}, {"period_ns": 1_500_000}, {"period_ns": 0}]
)
def test_what_is_no_drive(change: dict[str, int]) -> None:
    with pytest.raises(ValueError, match="no CiA 402 drive"):
        Cia402(CONFIG._replace(**change))  # type: ignore[arg-type]


@pytest.mark.parametrize("call", ["enable", "reset_fault"])
def test_calls_at_the_wrong_time_raise(call: str) -> None:
    with pytest.raises(ValueError, match=r"can't be enabled|no fault"):
        getattr(Cia402(CONFIG), call)()


def test_every_phase_but_the_first_can_be_left() -> None:
    for phase in set(HostPhase) - {HostPhase.DISCONNECTED}:
        assert any(source is phase for source, _ in TRANSITIONS)


@given(st.lists(st.tuples(st.integers(0, 0x7FF), st.binary(max_size=8), st.integers(0, 5 * MS)), max_size=40))
def test_whatever_comes_nothing_raises_and_no_torque_is_asked_for(frames: list[tuple[int, bytes, int]]) -> None:
    drive, n = ready()
    now_ns = n * MS
    for arbitration_id, data, step_ns in frames:
        now_ns += step_ns
        drive.receive(Frame(arbitration_id, data), now_ns)
        assert drive.setpoint(0) is None
        assert all(control in {0x00, 0x80} for control in controls(drive.poll(now_ns)))


def boot_up() -> Frame:
    return Frame(0x700 + NODE, b"\x00")


def test_a_drive_that_restarts_during_set_up_is_set_up_from_the_beginning() -> None:
    """Or its watchdog, which was written first, would be off for the whole run."""
    drive = Cia402(CONFIG)
    drive.connect(0)
    written: list[int] = []
    rebooted = False
    for n in range(200):
        for frame in drive.poll(n * MS):
            if frame.arbitration_id != 0x605:
                continue
            written.append(struct.unpack_from("<H", frame.data, 1)[0])
            if written.count(0x1016) == 1 and not rebooted:
                rebooted = True
                drive.receive(boot_up(), n * MS)
            else:
                drive.receive(answer(frame), n * MS)
    assert written.count(0x1016) == 2


def test_a_fault_before_set_up_is_over_does_not_skip_it() -> None:
    drive = Cia402(CONFIG)
    drive.connect(0)
    for state in (State.FAULT, State.SWITCH_ON_DISABLED):
        drive.receive(position(1, state), MS)
        assert drive.phase is HostPhase.IDENTIFYING


def test_behind_a_fault_the_mode_is_looked_at() -> None:
    drive, _, n = set_up()
    drive.poll(n * MS)
    drive.receive(position(1, State.FAULT, mode=1), (n + 1) * MS)
    assert drive.phase.name == "FAULT"
    for k in range(n + 2, n + 700):
        drive.receive(position(1, State.SWITCH_ON_DISABLED, mode=1), k * MS)
        drive.receive(current(0), k * MS)
        drive.poll(k * MS)
        assert drive.phase.name != "READY"
    assert "stays in mode 1" in drive.refusal


def test_torque_is_taken_off_a_drive_that_was_silent() -> None:
    drive, n = running()
    drive.poll(n * MS + SILENCE_NS + MS)
    assert drive.phase is HostPhase.DISCONNECTED
    drive.disable()
    n += SILENCE_NS // MS + 2
    drive.receive(position(1, State.OPERATION_ENABLED), n * MS)
    assert controls(drive.poll(n * MS)) == [0x00]


def test_a_drive_with_torque_and_without_references_is_not_told_that_the_host_lives() -> None:
    drive, n = running()
    drive.disable()
    frames = [frame for k in range(n, n + 300) for frame in tick(drive, k, State.OPERATION_ENABLED)]
    assert [frame for frame in frames if frame.arbitration_id == 0x700 + HOST_NODE] == []


def test_the_heartbeat_is_faster_than_a_short_watchdog() -> None:
    drive, _, n = set_up(CONFIG._replace(host_timeout_ns=9 * MS))
    frames = [frame for k in range(n, n + 30) for frame in tick(drive, k, State.SWITCH_ON_DISABLED)]
    assert len([frame for frame in frames if frame.arbitration_id == 0x700 + HOST_NODE]) == 10


def test_a_current_that_no_recording_holds_is_counted() -> None:
    drive, n = running()
    drive.take_samples()
    drive.receive(position(1, State.OPERATION_ENABLED), n * MS)
    drive.receive(current(2**31 - 1), n * MS)
    assert drive.take_samples() == []
    assert drive.counters["out_of_range"] == 1


def test_a_statusword_of_no_state_is_no_end_of_torque() -> None:
    drive, n = running()
    drive.receive(Frame(0x180 + NODE, struct.pack("<ihb", 1, 0x0003, 8)), n * MS)
    assert drive.drive_state is DriveState.ARMED
    assert drive.phase is HostPhase.READY
    assert drive.counters["unknown_status"] == 1
    drive.disable()
    assert controls(drive.poll(n * MS)) == [0x00]


def test_a_drive_that_leaves_its_mode_while_running_is_refused_and_its_torque_taken_off() -> None:
    drive, n = running()
    drive.receive(position(1, State.OPERATION_ENABLED, mode=1), n * MS)
    assert drive.phase is HostPhase.REFUSED
    assert "from mode 8 to mode 1" in drive.refusal
    assert drive.setpoint(0) is None
    drive.disable()
    drive.receive(current(0), n * MS)
    frames = drive.poll(n * MS)
    assert controls(frames) == [0x00]
    assert frames[-1] == wire.sync()  # or nothing would say that the torque is off
    drive.receive(position(1, State.SWITCH_ON_DISABLED, mode=1), (n + 1) * MS)
    assert drive.drive_state is DriveState.DISABLED


def test_a_drive_that_another_master_stops_is_refused() -> None:
    drive, n = running()
    drive.receive(Frame(0x700 + NODE, b"\x7f"), n * MS)  # perhaps made before NMT start
    assert drive.phase is HostPhase.RUNNING
    later = n + 501
    for k in range(n, later):
        tick(drive, k, State.OPERATION_ENABLED)
    drive.receive(Frame(0x700 + NODE, b"\x7f"), later * MS)
    assert drive.phase.name == "REFUSED"
    assert "left the NMT state operational" in drive.refusal
    assert drive.drive_state is None
    drive.disable()
    assert Frame(0x605, bytes.fromhex("2b40600000000000")) in drive.poll(later * MS)


def test_a_reset_that_was_not_needed_does_not_clear_the_next_fault() -> None:
    drive, n = running()
    drive.receive(position(1, State.FAULT), n * MS)
    drive.reset_fault()
    drive.receive(position(1, State.SWITCH_ON_DISABLED), n * MS)
    assert [controls(tick(drive, n + k, State.FAULT)) for k in range(1, 4)] == [[], [], []]


def test_connecting_twice_raises() -> None:
    drive, n = running()
    with pytest.raises(ValueError, match="connected already"):
        drive.connect(n * MS)


def test_frames_with_29_bits_are_somebody_elses() -> None:
    drive, n = running()
    drive.take_samples()
    before = dict(drive.counters)
    foreign = (position(5, State.FAULT), current(7), boot_up(), Frame(0x80 + NODE, bytes.fromhex("3081110000000000")))
    for frame in foreign:
        drive.receive(frame._replace(is_extended=True), n * MS)
    assert drive.phase is HostPhase.RUNNING
    assert drive.take_samples() == []
    assert drive.counters == {**before, "not_for_us": before["not_for_us"] + len(foreign)}
