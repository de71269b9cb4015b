"""The VESC profile: who sends what when, what it makes of what comes, and that nothing from outside raises."""

import binascii
import math
import struct
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.frames import Frame
from firmware_protocol.messages import DriveState
from firmware_protocol.scales import ANGLE_LSB_PER_REV, ANGLE_LSB_RAD, CURRENT_LSB_A
from firmware_protocol.states import HostPhase
from hil_forceps.drives.vesc.machine import SILENCE_NS, TRANSITIONS, Vesc, VescConfig
from hil_forceps.drives.vesc.turns import TurnsConfig

NODE, HOST, MS = 5, 253, 1_000_000
TURNS = TurnsConfig(low_rev=-0.2, high_rev=0.6, speed_rev_per_s=10.0, period_ns=2 * MS, count_rev=1e-4)
CONFIG = VescConfig(NODE, 1.0, 0.0, 100 * MS, TURNS)
SET_CURRENT, SET_POS, REQUEST = 1, 4, 8
asked = [0x218020]  # the mask of the last request, which an answer has too


def answer(
    position_deg: float = 36.0,
    current: int = 0,
    fault: int = 0,
    status: int = 0,
    node: int = NODE,
    *,
    cut: int = 0,
) -> list[Frame]:
    """The frames of an answer; `current` in hundredths of an ampere."""
    data = struct.pack(">BIiBiB", 50, asked[0], current, fault, round(position_deg * 1e6), status)
    data = data[: len(data) - cut]
    parts = [Frame(5 << 8 | HOST, bytes((at,)) + data[at : at + 7], is_extended=True) for at in range(0, len(data), 7)]
    end = struct.pack(">BBHH", node, 1, len(data), binascii.crc_hqx(data, 0))
    return [*parts, Frame(7 << 8 | HOST, end, is_extended=True)]


class Bench:
    """A machine with a VESC that answers each request a millisecond later, as `says` tells it; ticks of 2 ms."""

    def __init__(self, config: VescConfig = CONFIG) -> None:
        self.drive = Vesc(config)
        self.now_ms = 0
        self.fed_ms = -1000
        self.timeout_ms = 100
        self.says: Callable[[], list[Frame]] = lambda: answer(status=self.has_timeout())
        self.raw: int | None = None  # what the service asks for
        self.sent: list[Frame] = []

    def has_timeout(self) -> int:
        return int(self.timeout_ms > 0 and self.now_ms // 10 * 10 - self.fed_ms > self.timeout_ms)

    def tick(self, count: int = 1) -> list[Frame]:
        """What goes out in some ticks, without the requests."""
        sent: list[Frame] = []
        for _ in range(count):
            self.now_ms += 2
            reference = None if self.raw is None else self.drive.setpoint(self.raw)
            frames = [] if reference is None else [reference]
            frames += self.drive.poll(self.now_ms * MS)
            for frame in frames:
                assert frame.is_extended
                assert frame.arbitration_id & 0xFF == NODE
                if command(frame) in {SET_CURRENT, SET_POS}:
                    self.fed_ms = self.now_ms + 1
                    sent.append(frame)
                elif command(frame) == REQUEST:
                    (asked[0],) = struct.unpack_from(">I", frame.data, 3)
                    self.hear(*self.says())
        self.sent += sent
        return sent

    def hear(self, *frames: Frame) -> None:
        for at, frame in enumerate(frames):
            self.drive.receive(frame, (self.now_ms + 1) * MS + at * 100_000)

    def ready(self) -> "Bench":
        self.drive.connect(0)
        self.tick(100)
        assert self.drive.phase is HostPhase.READY
        self.drive.take_samples()
        self.sent = []
        return self

    def running(self) -> "Bench":
        self.ready()
        self.drive.enable()
        self.raw = round(0.1 * ANGLE_LSB_PER_REV)
        self.tick(12)
        assert self.drive.phase.name == "RUNNING"
        return self


def command(frame: Frame) -> int:
    return frame.arbitration_id >> 8


def position_deg(frame: Frame) -> float:
    return float(struct.unpack(">i", frame.data)[0]) / 1e6


def test_nothing_but_requests_goes_out_before_it_answers() -> None:
    bench = Bench()
    bench.drive.connect(0)
    bench.says = list
    assert bench.tick(400) == []
    assert bench.drive.phase is HostPhase.IDENTIFYING
    assert bench.drive.drive_state is None


def test_its_timeout_is_tried_with_one_release_and_then_it_is_ready() -> None:
    bench = Bench()
    bench.drive.connect(0)
    sent = bench.tick(100)
    assert [(command(frame), frame.data) for frame in sent] == [(SET_CURRENT, bytes(4))]
    assert bench.drive.phase is HostPhase.READY
    assert bench.drive.drive_state is DriveState.DISABLED


@pytest.mark.parametrize("timeout_ms", [0, 1000])
def test_a_timeout_that_is_off_or_longer_than_said_is_refused(timeout_ms: int) -> None:
    bench = Bench()
    bench.timeout_ms = timeout_ms
    bench.drive.connect(0)
    bench.tick(300)
    assert bench.drive.phase is HostPhase.REFUSED
    assert "Timeout to 100 ms" in bench.drive.refusal
    assert "motor_driver.watchdog_s" in bench.drive.refusal
    assert len(bench.sent) == (timeout_ms > 0)  # one that others may command, or that has no timeout, is told nothing


def test_current_that_nobody_asked_for_is_refused() -> None:
    bench = Bench()
    bench.says = lambda: answer(status=bench.has_timeout(), current=3)  # a timeout brake current
    bench.drive.connect(0)
    bench.tick(505)
    assert bench.drive.phase is HostPhase.REFUSED
    assert "Timeout Brake Current" in bench.drive.refusal
    assert bench.drive.drive_state is DriveState.ARMED


def test_one_that_takes_no_command_is_refused() -> None:
    bench = Bench()
    bench.says = lambda: answer(status=1)
    bench.drive.connect(0)
    bench.tick(400)
    assert bench.drive.phase is HostPhase.REFUSED
    assert "takes no command" in bench.drive.refusal


def test_firmware_that_does_not_tell_its_timeout_is_refused() -> None:
    bench = Bench()
    bench.says = lambda: answer(cut=1)
    bench.drive.connect(0)
    bench.tick(3)
    assert bench.drive.phase is HostPhase.REFUSED
    assert "5.03" in bench.drive.refusal


def test_one_that_broadcasts_but_does_not_answer_is_refused() -> None:
    bench = Bench()
    bench.says = lambda: [Frame(9 << 8 | NODE, bytes(8), is_extended=True)]
    bench.drive.connect(0)
    bench.tick(600)
    assert bench.drive.phase is HostPhase.REFUSED
    assert "does not answer" in bench.drive.refusal
    assert bench.drive.counters["broadcasts"] > 0


def test_one_that_answers_otherwise_is_refused() -> None:
    bench = Bench()
    bench.says = lambda: answer(cut=2)
    bench.drive.connect(0)
    bench.tick(505)
    assert bench.drive.phase is HostPhase.REFUSED
    assert "other values than were asked for" in bench.drive.refusal


def test_a_boot_while_it_is_identified_begins_the_trial_anew() -> None:
    bench = Bench()
    bench.drive.connect(0)
    bench.tick(20)
    assert len(bench.sent) == 1
    bench.hear(Frame(57 << 8 | NODE, b"60_MK6", is_extended=True))
    bench.tick(30)
    assert bench.drive.phase is HostPhase.IDENTIFYING
    bench.tick(120)
    assert bench.drive.phase.name == "READY"
    assert len(bench.sent) == 2


def test_two_with_one_id_are_refused_whether_their_answers_are_whole_or_torn() -> None:
    whole, torn = Bench(), Bench()
    whole.says = lambda: [*answer(status=1), *answer(status=1, position_deg=40.0)]
    torn.says = lambda: [
        frame for pair in zip(answer(status=1), answer(status=1, position_deg=40.0), strict=True) for frame in pair
    ]
    for bench in (whole, torn):
        bench.drive.connect(0)
        bench.tick(15)
        assert bench.drive.phase is HostPhase.REFUSED
        assert "two VESCs have this id" in bench.drive.refusal
        assert {command(frame) for frame in bench.sent} <= {SET_CURRENT}


def test_a_start_that_may_be_in_several_turns_is_refused() -> None:
    bench = Bench(CONFIG._replace(turns=TURNS._replace(high_rev=3.0)))
    bench.drive.connect(0)
    bench.tick(10)
    assert bench.drive.phase is HostPhase.REFUSED
    assert "`limits:`" in bench.drive.refusal


def test_the_first_reference_is_the_measured_angle_and_stays_until_it_is_taken() -> None:
    bench = Bench().ready()
    bench.drive.enable()
    frames: list[Frame] = []
    states = []
    for n in range(7):
        bench.raw = round(0.1 * ANGLE_LSB_PER_REV) + 1000 * n  # a load pushes the motor away
        frames += bench.tick()
        states.append(bench.drive.drive_state)
    enabling = states.count(DriveState.ARMED) + 1
    assert enabling >= 3
    assert len({frame.data for frame in frames[:enabling]}) == 1
    assert position_deg(frames[0]) == pytest.approx(36.0, abs=1e-4)
    assert bench.drive.phase.name == "RUNNING"
    assert position_deg(frames[-1]) == pytest.approx(36.0 + 6000 / ANGLE_LSB_PER_REV * 360.0, abs=1e-4)
    assert states == [DriveState.ARMED] * (enabling - 1) + [DriveState.OPERATIONAL] * (8 - enabling)


def test_answers_that_say_timeout_do_not_count_as_taken() -> None:
    bench = Bench().ready()
    bench.says = lambda: answer(status=1)
    bench.drive.enable()
    bench.raw = round(0.1 * ANGLE_LSB_PER_REV)
    bench.tick(100)
    assert bench.drive.phase is HostPhase.ENABLING


def test_enabling_begins_anew_where_its_references_stayed_away() -> None:
    bench = Bench().ready()
    bench.drive.enable()
    bench.says = lambda: answer(status=1)
    bench.raw = 1_000_000
    assert [round(position_deg(frame), 4) for frame in bench.tick(3)] == [21.4577] * 3
    bench.raw = None
    bench.tick(60)
    bench.raw = 1_010_000  # where the motor is by now
    assert [round(position_deg(frame), 4) for frame in bench.tick(3)] == [21.6722] * 3


def test_torque_by_another_word_is_released_before_the_first_reference() -> None:
    bench = Bench().ready()
    bench.drive.enable()
    bench.says = lambda: answer(current=20, status=bench.has_timeout())
    bench.tick()
    bench.raw = 1_000_000
    assert [command(frame) for frame in bench.tick(40)] == [SET_CURRENT] * 2  # 50 ms apart
    bench.says = lambda: answer(status=bench.has_timeout())
    assert SET_POS in [command(frame) for frame in bench.tick(20)]


def test_nothing_but_references_feeds_the_timeout_of_a_running_drive() -> None:
    bench = Bench().running()
    assert {command(frame) for frame in bench.tick(100)} == {SET_POS}
    bench.raw = None
    assert bench.tick(40) == []


def test_references_that_stay_away_end_it_and_do_not_begin_again() -> None:
    bench = Bench().running()
    bench.raw = None
    bench.tick(60)
    assert bench.drive.phase is HostPhase.FAULT
    assert "timeout" in bench.drive.fault_words()
    bench.raw = 1_000_000  # a VESC would take it and go on
    assert bench.tick(50) == []


def test_a_host_that_stood_still_knows_it_by_its_own_clock() -> None:
    bench = Bench().running()
    bench.now_ms += 300
    bench.drive.poll(bench.now_ms * MS)
    assert bench.drive.phase is not HostPhase.RUNNING


def test_a_fault_ends_it_though_the_vesc_forgets_it() -> None:
    bench = Bench().running()
    bench.says = lambda: answer(fault=4)
    bench.tick()
    assert bench.drive.phase is HostPhase.FAULT
    assert bench.drive.fault_words() == "fault 4 (absolute over current)"
    bench.says = lambda: answer(status=bench.has_timeout())
    assert bench.tick(300) == []
    assert bench.drive.phase.name == "FAULT"
    bench.drive.disable()
    assert bench.tick()[0].data == bytes(4)
    bench.drive.reset_fault()
    bench.tick(200)
    assert bench.drive.phase.name == "READY"


def test_a_fault_is_no_word_about_torque() -> None:
    bench = Bench().running()
    bench.says = lambda: answer(current=15)
    bench.tick(3)
    bench.says = lambda: answer(fault=4)
    states = []
    for _ in range(3):
        bench.tick()
        states.append(bench.drive.drive_state)
    assert states == [None, None, DriveState.FAULT]


def test_the_kill_switch_is_a_fault() -> None:
    bench = Bench().running()
    bench.says = lambda: answer(status=2)
    bench.tick()
    assert bench.drive.phase is HostPhase.FAULT
    assert "kill switch" in bench.drive.fault_words()


def test_disabling_orders_the_release_until_answers_from_behind_it_have_no_current() -> None:
    bench = Bench().running()
    bench.says = lambda: answer(current=15, status=bench.has_timeout())
    bench.tick(2)
    bench.drive.disable()
    states = [bench.drive.drive_state]
    assert bench.drive.setpoint(0) is None
    sent = bench.tick(80)
    assert [command(frame) for frame in sent] == [SET_CURRENT] * 4
    bench.says = lambda: answer(status=bench.has_timeout())
    bench.tick(2)
    states.append(bench.drive.drive_state)  # two answers may be chance
    bench.tick()
    states.append(bench.drive.drive_state)
    assert states == [None, DriveState.ARMED, DriveState.DISABLED]
    assert bench.tick(100) == []


def test_answers_from_before_the_release_do_not_confirm_it() -> None:
    bench = Bench().running()  # its motor holds nothing: no current flows
    late = list(answer())  # to a request from before
    bench.drive.disable()
    states = []
    for _ in range(3):
        bench.hear(*late)
        bench.tick()
        states.append(bench.drive.drive_state)
    assert states == [None, None, DriveState.DISABLED]


def test_a_drive_that_boots_or_falls_silent_is_gone_and_gets_no_reference() -> None:
    boots, silent = Bench().running(), Bench().running()
    boots.hear(Frame(57 << 8 | NODE, b"60_MK6", is_extended=True))
    silent.says = list
    silent.tick(SILENCE_NS // MS // 2 + 2)
    for bench in (boots, silent):
        assert bench.drive.phase is HostPhase.DISCONNECTED
        assert bench.drive.drive_state is None
        assert bench.drive.setpoint(0) is None
        bench.drive.disable()
        assert [command(frame) for frame in bench.tick(2)] == [SET_CURRENT]


def test_another_program_that_commands_it_is_an_end() -> None:
    bench = Bench().running()
    bench.hear(Frame(3 << 8 | NODE, struct.pack(">i", 3000), is_extended=True))
    assert bench.drive.phase is HostPhase.REFUSED
    assert "SET_RPM" in bench.drive.refusal
    bench.drive.disable()
    assert [command(frame) for frame in bench.tick(3)] == [SET_CURRENT]
    bench.tick(10)
    assert bench.drive.drive_state is DriveState.DISABLED


@pytest.mark.parametrize("raw", [round(0.61 * ANGLE_LSB_PER_REV), round(-0.41 * ANGLE_LSB_PER_REV)])
def test_half_a_turn_away_the_vesc_would_go_the_other_way_round(raw: int) -> None:
    bench = Bench().running()
    bench.raw = raw
    assert bench.tick() == []
    assert bench.drive.phase is HostPhase.REFUSED
    assert "shorter way" in bench.drive.refusal


def test_a_sample_has_angle_and_current_of_one_answer() -> None:
    bench = Bench().running()
    bench.drive.take_samples()
    bench.says = lambda: answer(position_deg=37.0, current=-21)
    bench.tick()
    (sample,) = bench.drive.take_samples()
    assert sample.theta_m * ANGLE_LSB_RAD == pytest.approx(math.radians(37.0), abs=1e-6)
    assert sample.current * CURRENT_LSB_A == pytest.approx(-0.215, abs=2e-4)
    assert (sample.stamp_ns, sample.received_ns) == (bench.now_ms * MS, (bench.now_ms + 1) * MS)
    assert sample.state == DriveState.OPERATIONAL


@pytest.mark.parametrize("ratio", [1.0, -1.0, 2.5, -0.5])
def test_gear_sign_and_zero_are_those_of_the_rig(ratio: float) -> None:
    ends = sorted((0.3 - 0.1 * ratio, 0.3 + 0.25 * ratio))
    bench = Bench(
        CONFIG._replace(rev_per_pulley_rev=ratio, zero_rev=0.3, turns=TURNS._replace(low_rev=ends[0], high_rev=ends[1]))
    )
    raw = round(0.125 * ANGLE_LSB_PER_REV)
    told_deg = (0.3 + 0.125 * ratio) % 1.0 * 360.0
    bench.says = lambda: answer(position_deg=told_deg, status=bench.has_timeout())
    bench.ready()
    bench.drive.enable()
    bench.raw = raw
    (frame,) = bench.tick()
    assert position_deg(frame) == pytest.approx(told_deg, abs=1e-5)
    bench.says = lambda: answer(position_deg=told_deg, current=20)
    bench.tick()
    sample = bench.drive.take_samples()[-1]
    assert sample.theta_m == pytest.approx(raw, abs=20)
    assert sample.current * CURRENT_LSB_A == pytest.approx(math.copysign(0.205, ratio), abs=2e-4)


def test_turns_are_counted_past_the_wrap_and_references_go_with_them() -> None:
    bench = Bench(CONFIG._replace(turns=TURNS._replace(low_rev=0.5, high_rev=1.4)))
    bench.says = lambda: answer(position_deg=350.0, status=bench.has_timeout())
    bench.ready()
    angle = 350.0
    for _ in range(20):
        angle += 1.0
        bench.says = lambda angle=angle: answer(position_deg=angle % 360.0)  # type: ignore[misc]
        bench.tick()
    assert bench.drive.take_samples()[-1].theta_m * ANGLE_LSB_RAD == pytest.approx(math.radians(370.0), abs=1e-6)
    assert bench.drive.counters["jumps"] == 0


def test_a_jump_is_counted_and_refused() -> None:
    bench = Bench().running()
    bench.drive.take_samples()
    bench.says = lambda: answer(position_deg=126.0)
    bench.tick()
    assert bench.drive.take_samples() == []
    assert bench.drive.counters["jumps"] == 1
    bench.says = answer
    bench.tick()
    assert len(bench.drive.take_samples()) == 1


def test_turns_that_can_not_be_counted_any_more_end_it() -> None:
    bench = Bench().running()
    bench.says = list
    bench.tick(25)  # half a turn, at 10 turns a second
    assert bench.drive.phase.name == "RUNNING"
    bench.says = answer
    bench.tick()
    assert bench.drive.phase is HostPhase.DISCONNECTED


def test_lost_answers_are_counted_and_cost_nothing_else() -> None:
    bench = Bench().running()
    before = dict(bench.drive.counters)
    bench.says = lambda: answer()[1:]
    bench.tick(3)
    assert bench.drive.counters["torn_answers"] > before["torn_answers"]
    bench.says = list
    bench.tick(3)
    bench.says = answer
    bench.tick(3)
    assert bench.drive.counters["unanswered"] == before["unanswered"] + 6
    assert bench.drive.phase is HostPhase.RUNNING
    assert {command(frame) for frame in bench.sent} == {SET_POS}


@pytest.mark.parametrize("call", ["enable", "reset_fault"])
def test_calls_at_the_wrong_time_raise(call: str) -> None:
    with pytest.raises(ValueError, match=r"can't be enabled|no fault"):
        getattr(Vesc(CONFIG), call)()
    with pytest.raises(ValueError, match="connected already"):
        Bench().running().drive.connect(0)


@pytest.mark.parametrize("change", [{"node": 253}, {"node": -1}, {"rev_per_pulley_rev": 0.0}, {"timeout_ns": 0}])
def test_what_is_no_vesc(change: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="no VESC"):
        Vesc(CONFIG._replace(**change))  # type: ignore[arg-type]


def test_every_phase_but_the_first_can_be_left() -> None:
    for phase in set(HostPhase) - {HostPhase.DISCONNECTED}:
        assert any(source is phase for source, _ in TRANSITIONS)


def test_frames_with_11_bits_are_somebody_elses() -> None:
    bench = Bench().running()
    before = bench.drive.counters["not_for_us"]
    for frame in [*answer(fault=3), Frame(0x339, b"\0\0\0\0"), Frame(57 << 8 | NODE, b"")]:
        bench.hear(frame._replace(is_extended=False))
    assert bench.drive.phase is HostPhase.RUNNING
    assert bench.drive.counters["not_for_us"] == before + 6


FRAMES = st.one_of(
    st.builds(Frame, st.integers(0, 0x7FF), st.binary(max_size=8)),
    st.builds(
        lambda command, node, data: Frame(command << 8 | node, data, is_extended=True),
        st.integers(0, 70),
        st.sampled_from([NODE, HOST, 255, 1]),
        st.binary(max_size=8),
    ),
)


@given(st.lists(st.tuples(FRAMES, st.integers(-5, 20 * MS)), max_size=40))
def test_whatever_comes_nothing_raises_and_nothing_that_moves_is_sent_unasked(frames: list[tuple[Frame, int]]) -> None:
    bench = Bench().ready()
    drive, now_ns = bench.drive, bench.now_ms * MS
    for frame, step_ns in frames:
        now_ns += step_ns
        drive.receive(frame, now_ns)
        assert {command(sent) for sent in drive.poll(now_ns)} <= {REQUEST}
        assert drive.setpoint(0) is None
    stamps = [sample.stamp_ns for sample in drive.take_samples()]
    assert stamps == sorted(set(stamps))


@given(
    st.lists(
        st.tuples(st.integers(-(2**31), 2**31 - 1), st.integers(0, 255), st.integers(-10, 370), st.integers(0, 255)),
        max_size=40,
    )
)
def test_whatever_a_running_one_answers_nothing_raises(values: list[tuple[int, int, int, int]]) -> None:
    bench = Bench().running()
    for current, fault, angle, status in values:
        bench.says = lambda found=(angle, current, fault, status): answer(*found)  # type: ignore[misc]
        bench.tick()
    if any(fault for _, fault, angle, _ in values if 0 <= angle <= 360):
        assert bench.drive.phase.name in {"FAULT", "DISCONNECTED", "REFUSED"}
