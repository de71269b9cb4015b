"""The moteus profile: asking, the state machine, what feeds its watchdog, and that nothing from outside raises."""

import math
import struct
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.frames import Frame
from firmware_protocol.messages import DriveState
from firmware_protocol.scales import ANGLE_LSB_PER_REV, CURRENT_LSB_A
from firmware_protocol.states import HostPhase
from hil_forceps.drives.moteus import messages as wire
from hil_forceps.drives.moteus.machine import FLIGHT_NS, IDENTIFY_EVERY_NS, TRANSITIONS, Moteus, MoteusConfig
from hil_forceps.drives.moteus.messages import Mode
from hil_forceps.drives.moteus.subframes import parse_subframes
from hil_forceps.drives.registry import machine_for
from hil_forceps.rig import load_rig

RIG_FILE = Path(__file__).parents[4] / "configs" / "drives" / "moteus.yaml"
NODE, MS = 5, 1_000_000
CONFIG = MoteusConfig(NODE, 1.0, 0.0, 0.0135, 0.1, 100 * MS)
IDENTITY = struct.pack("<BBBii", 0x2A, 0x81, 0x02, 0x010100, 5)
MODE_AND = b"\x01\x00"  # a frame that writes the mode begins so


def answer(
    mode: int, ms: int, position: float = 0.1, current: float = 0.0, fault: int = 0, more: bytes = b"", node: int = NODE
) -> Frame:
    data = (
        struct.pack("<BBb", 0x21, 0, mode)
        + struct.pack("<BBff", 0x2E, 1, position, 0.0)
        + struct.pack("<BBf", 0x2D, 4, current)
        + struct.pack("<BBb", 0x21, 0x0F, fault)
        + struct.pack("<BBI", 0x29, 0x70, ms & 0xFFFFFFFF)
        + more
    )
    length = 32 if len(data) <= 32 else 48
    return Frame(node << 8, data.ljust(length, b"\x50"), True, node > 7)


class Session:
    """A machine, tick by tick: what it sends, and what the drive answers to it half a millisecond later."""

    def __init__(self, config: MoteusConfig = CONFIG) -> None:
        self.drive = Moteus(config)
        self.ms = 0
        self.drive.connect(0)

    def tick(self, mode: int | None, raw: int = 1000, **more: Any) -> list[Frame]:
        """Send what is due, and answer it with a mode, or not at all; return what was sent."""
        now_ns = self.ms * MS
        reference = self.drive.setpoint(raw)
        sent = ([] if reference is None else [reference]) + self.drive.poll(now_ns)
        if mode is not None and sent:
            identity = IDENTITY if self.drive.phase.name == "IDENTIFYING" else b""
            reply = answer(mode, self.ms, more=identity, node=self.drive.config.node, **more)
            self.drive.receive(reply, now_ns + MS // 2)
        self.ms += 1
        return sent

    def state(self) -> DriveState | None:
        return self.drive.drive_state

    def ready(self) -> "Session":
        self.tick(Mode.STOPPED)
        assert self.drive.phase.name == "READY"
        return self

    def running(self) -> "Session":
        self.ready()
        self.drive.enable()
        for mode in (Mode.STOPPED, Mode.ENABLING, Mode.CALIBRATING, Mode.POSITION):
            self.tick(mode)
        assert self.drive.phase.name == "RUNNING"
        return self


def commands(frames: list[Frame]) -> list[int]:
    """The modes that frames write; -1 for one that writes none."""
    return [frame.data[2] if frame.data.startswith(MODE_AND) else -1 for frame in frames]


def test_nothing_but_queries_goes_out_before_the_drive_is_known() -> None:
    session = Session()
    sent = [frame for _ in range(200) for frame in session.tick(None)]
    assert commands(sent) == [-1] * (200 * MS // IDENTIFY_EVERY_NS)
    assert session.drive.phase.name == "IDENTIFYING"
    subframes = parse_subframes(sent[0].data) or []
    assert {each.kind for each in subframes} == {"read"}
    assert all(frame.is_extended and frame.is_fd and frame.arbitration_id == 0x8005 for frame in sent)


def test_one_frame_goes_out_each_tick_and_it_asks_in_every_phase() -> None:
    session = Session().ready()
    for _ in range(20):
        assert commands(session.tick(Mode.STOPPED)) == [-1]
    session.drive.enable()
    for _ in range(20):
        assert commands(session.tick(Mode.CALIBRATING)) == [Mode.POSITION]
    for _ in range(20):
        assert commands(session.tick(Mode.POSITION)) == [Mode.POSITION]
    session.drive.disable()
    assert commands(session.tick(Mode.POSITION)) == [Mode.STOPPED]


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (
            struct.pack("<BBBii", 0x2A, 0x81, 0x02, 0x000103, 4),
            "version 4 of moteus' registers (firmware 0.1.3), and 5",
        ),
        (bytes.fromhex("31810201"), "has no register 0x101"),
        (bytes.fromhex("31820201"), "has no register 0x102"),
    ],
)
def test_other_registers_are_refused_with_the_remedy(more: bytes, said: str) -> None:
    session = Session()
    session.drive.poll(0)
    session.drive.receive(answer(Mode.STOPPED, 5, more=more), MS)
    assert session.drive.phase.name == "REFUSED"
    assert said in session.drive.refusal
    assert "moteus_tool --flash" in session.drive.refusal
    assert "\n" not in session.drive.refusal
    assert session.tick(None) == []


def test_a_firmware_without_its_clock_is_refused() -> None:
    session = Session()
    session.drive.poll(0)
    cut = answer(Mode.STOPPED, 5).data[:22] + bytes.fromhex("317001") + b"\x50" * 7
    session.drive.receive(Frame(NODE << 8, cut, True), MS)
    assert "has no register 0x070" in session.drive.refusal


@pytest.mark.parametrize("mode", [Mode.POSITION, Mode.CURRENT, Mode.ZERO_VELOCITY, Mode.BRAKE])
def test_one_that_somebody_else_drives_is_refused(mode: Mode) -> None:
    session = Session()
    session.tick(mode)
    assert session.drive.phase.name == "REFUSED"
    assert f"is in mode {mode.value} already" in session.drive.refusal
    assert "moteus_tool -t 5 --stop" in session.drive.refusal


def test_one_that_prepares_is_waited_for() -> None:
    session = Session()
    session.tick(Mode.CALIBRATING)
    assert session.drive.phase.name == "IDENTIFYING"
    session.ms += 20
    session.tick(Mode.STOPPED)
    assert session.drive.phase.name == "READY"


def test_the_first_reference_is_the_measured_angle_and_stays_there() -> None:
    session = Session().ready()
    session.drive.enable()
    sent = [frame for n in range(30) for frame in session.tick(Mode.CALIBRATING, raw=1000 + 5 * n)]
    positions = {struct.unpack_from("<f", frame.data, 5)[0] for frame in sent}
    assert positions == {struct.unpack("<f", struct.pack("<f", 1000 / ANGLE_LSB_PER_REV))[0]}


def test_every_reference_carries_torque_watchdog_and_no_trajectory() -> None:
    session = Session(CONFIG._replace(rev_per_pulley_rev=-3.0, zero_rev=0.5)).running()
    (frame,) = session.tick(Mode.POSITION, raw=ANGLE_LSB_PER_REV // 4)
    written = {
        each.register + place: value
        for each in parse_subframes(frame.data) or ()
        for place, value in enumerate(each.values)
    }
    single = {register: struct.unpack("<f", struct.pack("<f", value))[0] for register, value in written.items()}
    assert single == {
        0x00: Mode.POSITION,
        0x20: 0.5 - 0.75,
        0x25: pytest.approx(0.0135),
        0x27: pytest.approx(0.1),
        0x28: -1.0,
        0x29: -1.0,
    }
    assert not any(math.isnan(value) for value in written.values())


def test_a_lost_answer_is_asked_for_again_and_no_query_feeds_the_watchdog() -> None:
    session = Session().running()
    session.tick(None)
    session.ms += 1
    drive = session.drive
    sent = drive.poll(session.ms * MS)  # the service has no new sample, so no reference
    assert commands(sent) == [-1]
    for n in range(20):
        assert MODE_AND not in b"".join(frame.data[:2] for frame in drive.poll((session.ms + 1 + n) * MS))


def test_a_sample_is_in_the_projects_integers_and_stamped_between_request_and_answer() -> None:
    session = Session(CONFIG._replace(rev_per_pulley_rev=-2.0, zero_rev=0.25)).ready()
    session.drive.take_samples()
    session.tick(Mode.STOPPED, position=0.75, current=0.5)
    (sample,) = session.drive.take_samples()
    assert sample.theta_m == round((0.75 - 0.25) / -2.0 * ANGLE_LSB_PER_REV)
    assert sample.current == round(-0.5 / CURRENT_LSB_A)
    assert (sample.stamp_ns, sample.received_ns) == ((session.ms - 1) * MS + MS // 4, (session.ms - 1) * MS + MS // 2)
    assert sample.state == DriveState.DISABLED


@pytest.mark.parametrize("broken", [{"position": math.nan}, {"current": math.nan}, {"position": math.inf}])
def test_what_is_no_number_makes_no_sample(broken: dict[str, Any]) -> None:
    session = Session().running()
    session.drive.take_samples()
    session.tick(Mode.POSITION, **broken)
    assert session.drive.take_samples() == []
    assert session.drive.counters["no_value"] == 1
    assert session.drive.phase.name == "RUNNING"


def test_what_limits_the_torque_is_no_fault() -> None:
    session = Session().running()
    session.tick(Mode.POSITION, fault=102)
    assert session.drive.phase.name == "RUNNING"


@pytest.mark.parametrize(
    ("mode", "fault", "words", "state"),
    [
        (Mode.FAULT, 33, "fault 33 (motor driver fault", DriveState.FAULT),
        (Mode.TIMEOUT, 0, "watchdog expired (mode 11)", DriveState.ARMED),
    ],
)
def test_fault_and_timeout_end_it_and_only_a_stop_clears_them(
    mode: Mode, fault: int, words: str, state: DriveState
) -> None:
    session = Session().running()
    session.tick(mode, fault=fault)
    drive = session.drive
    assert drive.phase.name == "FAULT"
    assert drive.fault_words().startswith(words)
    assert drive.drive_state is state
    assert drive.setpoint(0) is None
    assert commands(session.tick(mode, fault=fault)) == [-1]
    drive.reset_fault()
    assert commands(session.tick(mode, fault=fault)) == [Mode.STOPPED]
    session.tick(Mode.STOPPED)
    assert drive.phase.name == "IDENTIFYING"
    session.ms += 20
    session.tick(Mode.STOPPED)
    assert drive.phase.name == "READY"


def test_a_fault_has_no_torque_and_is_kept_for_who_comes_next() -> None:
    """A stop would clear it."""
    session = Session().running()
    session.tick(Mode.FAULT, fault=38)
    session.drive.disable()
    assert session.drive.drive_state is DriveState.FAULT
    assert all(commands(session.tick(Mode.FAULT, fault=38)) == [-1] for _ in range(30))


def test_a_timeout_may_have_torque_and_is_stopped() -> None:
    session = Session().running()
    session.tick(Mode.TIMEOUT)
    session.drive.disable()
    assert commands(session.tick(Mode.TIMEOUT)) == [Mode.STOPPED]
    session.tick(Mode.STOPPED)
    assert session.drive.drive_state is DriveState.DISABLED or session.drive.phase.name == "IDENTIFYING"


def test_stops_go_on_until_an_answer_from_behind_them_says_stopped() -> None:
    session = Session().ready()
    session.drive.enable()
    session.tick(Mode.STOPPED)  # a command is on its way, which the answer doesn't show yet
    session.drive.disable()
    assert session.drive.drive_state is None
    stops = 0
    while session.state() is not DriveState.DISABLED:
        assert commands(session.tick(Mode.STOPPED)) == [Mode.STOPPED]
        stops += 1
    assert stops * MS == FLIGHT_NS + MS
    assert commands(session.tick(Mode.STOPPED)) == [-1]


def test_stops_go_on_while_nobody_answers() -> None:
    session = Session().running()
    session.drive.disable()
    assert all(commands(session.tick(None)) == [Mode.STOPPED] for _ in range(300))
    assert session.drive.drive_state is None


def test_a_drive_that_loses_its_mode_is_out() -> None:
    session = Session().running()
    session.tick(Mode.STOPPED)
    assert session.drive.phase.name == "READY"
    assert session.drive.setpoint(0) is None
    assert session.drive.drive_state is DriveState.ARMED  # what went out with the last reference may yet enable it


def test_a_drive_whose_clock_began_anew_is_gone_even_in_position_mode() -> None:
    session = Session().running()
    session.ms += 1000
    session.drive.receive(answer(Mode.POSITION, session.ms), session.ms * MS)
    session.drive.receive(answer(Mode.POSITION, 3), (session.ms + 1) * MS)
    assert session.drive.phase.name == "DISCONNECTED"
    assert session.drive.counters["restarts"] == 1
    assert session.drive.setpoint(0) is None
    session.drive.disable()
    assert session.drive.drive_state is None
    assert commands(session.tick(None)) == [Mode.STOPPED]


def test_a_late_answer_says_nothing() -> None:
    session = Session().running()
    session.tick(Mode.POSITION)
    session.drive.take_samples()
    session.drive.receive(answer(Mode.STOPPED, session.ms - 10), session.ms * MS)
    assert session.drive.phase.name == "RUNNING"
    assert session.drive.take_samples() == []
    assert session.drive.counters["stale"] == 1


def test_the_clock_may_wrap() -> None:
    session = Session().running()
    for n, ms in enumerate((0x7FFFFFFE, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 0, 5)):
        session.drive._feedback = None if n == 0 else session.drive._feedback
        session.drive.receive(answer(Mode.POSITION, ms), (session.ms + n) * MS)
    assert session.drive.phase.name == "RUNNING"
    assert session.drive.counters["restarts"] == 0


def test_silence_is_the_end_of_it() -> None:
    session = Session().running()
    for _ in range(102):
        session.tick(None)
    assert session.drive.phase.name == "DISCONNECTED"
    assert session.drive.drive_state is None


@pytest.mark.parametrize("node", [7, 8])
def test_an_answer_has_as_many_bits_as_its_id_takes(node: int) -> None:
    session = Session(CONFIG._replace(node=node))
    reply = answer(Mode.STOPPED, 5, more=IDENTITY, node=node)
    for foreign in (
        reply._replace(is_extended=not reply.is_extended),
        reply._replace(is_fd=False),
        reply._replace(arbitration_id=reply.arbitration_id | 1),
        reply._replace(arbitration_id=reply.arbitration_id | 1 << 16, is_extended=True),
        Frame(0x8000 | node, reply.data, True, True),
    ):
        session.drive.poll(0)
        session.drive.receive(foreign, MS)
        assert session.drive.phase.name == "IDENTIFYING"
    assert session.drive.counters["not_for_us"] == 5
    session.drive.receive(reply, MS)
    assert session.drive.phase.name == "READY"


@pytest.mark.parametrize("call", ["enable", "reset_fault"])
def test_calls_at_the_wrong_time_are_a_mistake(call: str) -> None:
    with pytest.raises(ValueError, match=r"can't be enabled|no fault"):
        getattr(Moteus(CONFIG), call)()


@pytest.mark.parametrize(
    "change",
    [{"node": 0}, {"node": 127}, {"rev_per_pulley_rev": 0.0}, {"max_torque_N_m": math.nan}, {"watchdog_s": -1.0}],
)
def test_what_is_no_moteus(change: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=r"no moteus|no command"):
        Moteus(CONFIG._replace(**change))  # type: ignore[arg-type]


def test_every_phase_but_the_first_can_be_left() -> None:
    for phase in set(HostPhase) - {HostPhase.DISCONNECTED}:
        assert any(source is phase for source, _ in TRANSITIONS)


def test_the_emergency_frame_is_a_stop() -> None:
    assert Moteus(CONFIG).estop_frame() == wire.stop(NODE)
    assert Moteus(CONFIG).fault_words() == "no fault given"
    assert Moteus(CONFIG).take_bench() == []


IDS = st.sampled_from([(NODE << 8, False), (NODE << 8, True), (0x8005, True), (0x100, False)])
ANSWERS = st.builds(
    lambda mode, ms, position, fault: answer(mode, ms, position, fault=fault).data,
    st.integers(-128, 127),
    st.integers(0, 2**32 - 1),
    st.floats(width=32),
    st.integers(-128, 127),
)


@given(st.lists(st.tuples(IDS, st.binary(max_size=64) | ANSWERS, st.integers(-5, 20 * MS)), max_size=40))
def test_whatever_comes_nothing_raises_and_no_torque_is_asked_for(
    frames: list[tuple[tuple[int, bool], bytes, int]],
) -> None:
    session = Session().ready()
    now_ns = session.ms * MS
    for (arbitration_id, is_extended), data, step_ns in frames:
        now_ns += step_ns
        session.drive.receive(Frame(arbitration_id, data, True, is_extended), now_ns)
        assert session.drive.setpoint(0) is None
        assert set(commands(session.drive.poll(now_ns))) <= {-1}
    stamps = [sample.stamp_ns for sample in session.drive.take_samples()]
    assert stamps == sorted(set(stamps))


@pytest.mark.parametrize("ratio", [1.0, -4.0])
def test_the_torque_limit_is_the_rigs_current_at_what_the_moteus_calls_its_output(ratio: float) -> None:
    """The rig's torque constant is at the pulley, which turns once for `ratio` turns of that output."""
    rig = load_rig(RIG_FILE).with_changes(
        {"motor_driver.encoder_rev_per_pulley_rev": ratio, "motor_driver.current_limit_A": 0.5}
    )
    drive = machine_for(rig)
    assert isinstance(drive, Moteus)
    torque_constant = rig.plant().torque_constant_N_m_per_A
    assert drive.config.max_torque_N_m == pytest.approx(0.5 * torque_constant / abs(ratio))
    assert drive.config.watchdog_s == 0.1
