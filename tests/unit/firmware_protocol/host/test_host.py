"""The host's phases by table, its heartbeats and its references (HFP-070 to HFP-087, HFP-100, HFP-101)."""

from collections.abc import Callable

import pytest

from firmware_protocol import codec
from firmware_protocol.frames import Frame
from firmware_protocol.host.machine import HostConfig, HostMachine, HostPhase
from firmware_protocol.messages import (
    BenchSensor,
    Discover,
    DriveHeartbeat,
    DriveState,
    Estop,
    FaultReason,
    HostHeartbeat,
    Identity,
    Message,
    ParamOp,
    ParamRequest,
    ParamResponse,
    Setpoint,
)
from firmware_protocol.states import HOST_COMMANDS, HOST_TRANSITIONS, HostEvent

MS = 1_000_000
NODE, SERIAL = 4, 0xABCDEF012345
P = HostPhase


class Desk:
    """A host with a hand-made drive at the other end."""

    def __init__(self, **settings: int | bool) -> None:
        self.host = HostMachine(HostConfig(**{"node": NODE, **settings}))  # type: ignore[arg-type]
        self.now_ns = 5_000 * MS
        self.n = 0
        self.heartbeat_sequence = 0
        self.sent: list[Message] = []

    def hear(self, message: Message) -> None:
        self.host.receive(codec.encode(message), self.now_ns)

    def sample(self, state: int = 0, fault: int = 0, theta: int = 777) -> None:
        self.n += 1
        for frame in (
            codec.encode_feedback(NODE, theta, 0, self.n & 0xFF),
            codec.encode_timing(NODE, self.n * 1_000, self.n & 0xFF, 0, state, fault),
        ):
            self.host.receive(frame, self.now_ns)

    def drive_heartbeat(self, state: int = 0, fault: int = 0, major: int = 1, lost: int = 0, advance: int = 1) -> None:
        self.heartbeat_sequence += advance
        sequence = self.heartbeat_sequence & 0xFF
        self.hear(DriveHeartbeat(NODE, state, fault, major, 0, 3, lost, sequence))

    def setpoint(self, theta: int) -> Frame | None:
        self.host.take_samples()
        return self.host.setpoint(theta)

    def phase(self) -> HostPhase:
        return self.host.phase

    def wait(self, ms: int, state: int | None = None) -> list[int]:
        """Poll each ms, with samples of that state; return the control bits of the heartbeats sent."""
        controls = []
        for _ in range(ms):
            self.now_ns += MS
            if state is not None:
                self.sample(state)
            for frame in self.host.poll(self.now_ns):
                message = codec.Decoder().decode(frame)
                assert message is not None
                self.sent.append(message)
                if isinstance(message, HostHeartbeat):
                    controls.append(message.control)
        return controls

    def identify(self) -> None:
        self.host.connect(self.now_ns)
        self.hear(Identity(NODE, SERIAL, 1, 0))

    def ready(self) -> None:
        self.identify()
        self.sample()

    def armed(self) -> None:
        self.ready()
        self.host.enable()
        self.wait(30, DriveState.DISABLED)
        self.sample(DriveState.ARMED)

    def running(self) -> None:
        self.armed()
        self.sample(DriveState.OPERATIONAL)

    def refused(self) -> None:
        self.host.connect(self.now_ns)
        self.hear(Identity(NODE, SERIAL, 2, 0))

    def faulted(self) -> None:
        self.ready()
        self.sample(DriveState.FAULT, FaultReason.SUPPLY)


PREPARE: dict[HostPhase, Callable[[Desk], None]] = {
    P.DISCONNECTED: lambda _: None,
    P.IDENTIFYING: lambda d: d.host.connect(d.now_ns),
    P.READY: Desk.ready,
    P.ENABLING: Desk.armed,
    P.RUNNING: Desk.running,
    P.FAULT: Desk.faulted,
    P.REFUSED: Desk.refused,
}

HAPPEN: dict[HostEvent, Callable[[Desk], object]] = {
    HostEvent.CONNECT: lambda d: d.host.connect(d.now_ns),
    HostEvent.ENABLE: lambda d: d.host.enable(),
    HostEvent.DISABLE: lambda d: d.host.disable(),
    HostEvent.RESET: lambda d: d.host.reset_fault(),
    HostEvent.IDENTIFIED: lambda d: d.hear(Identity(NODE, SERIAL, 1, 9)),
    HostEvent.MISFIT: lambda d: d.hear(Identity(NODE, SERIAL, 2, 0)),
    HostEvent.SAW_DISABLED: lambda d: d.sample(DriveState.DISABLED),
    HostEvent.SAW_ARMED: lambda d: d.sample(DriveState.ARMED),
    HostEvent.SAW_OPERATIONAL: lambda d: d.sample(DriveState.OPERATIONAL),
    HostEvent.SAW_FAULT: lambda d: d.sample(DriveState.FAULT, FaultReason.WATCHDOG),
    HostEvent.GONE: lambda d: d.wait(260),
    HostEvent.ENABLE_EXPIRED: lambda d: d.wait(1_001, int(d.host.drive_state or 0)),
}

EXPECTED: dict[HostPhase, dict[HostEvent, HostPhase]] = {
    P.DISCONNECTED: {HostEvent.CONNECT: P.IDENTIFYING},
    P.IDENTIFYING: {HostEvent.IDENTIFIED: P.READY, HostEvent.MISFIT: P.REFUSED},
    P.READY: {
        HostEvent.ENABLE: P.ENABLING,
        HostEvent.SAW_FAULT: P.FAULT,
        HostEvent.GONE: P.DISCONNECTED,
        HostEvent.MISFIT: P.REFUSED,
    },
    P.ENABLING: {
        HostEvent.DISABLE: P.READY,
        HostEvent.ENABLE_EXPIRED: P.READY,
        HostEvent.SAW_OPERATIONAL: P.RUNNING,
        HostEvent.SAW_FAULT: P.FAULT,
        HostEvent.GONE: P.DISCONNECTED,
        HostEvent.MISFIT: P.REFUSED,
    },
    P.RUNNING: {
        HostEvent.DISABLE: P.READY,
        HostEvent.SAW_DISABLED: P.READY,
        HostEvent.SAW_ARMED: P.READY,
        HostEvent.SAW_FAULT: P.FAULT,
        HostEvent.GONE: P.DISCONNECTED,
        HostEvent.MISFIT: P.REFUSED,
    },
    P.FAULT: {HostEvent.SAW_DISABLED: P.READY, HostEvent.GONE: P.DISCONNECTED, HostEvent.MISFIT: P.REFUSED},
    P.REFUSED: {HostEvent.CONNECT: P.IDENTIFYING},
}
ALLOWED = {
    HostEvent.CONNECT: {P.DISCONNECTED, P.IDENTIFYING, P.REFUSED},
    HostEvent.ENABLE: {P.READY, P.ENABLING, P.RUNNING},
    HostEvent.DISABLE: set(P),
    HostEvent.RESET: {P.FAULT},
}


def test_the_tables_are_these() -> None:
    assert HOST_TRANSITIONS == EXPECTED
    assert {event: set(phases) for event, phases in HOST_COMMANDS.items()} == ALLOWED


@pytest.mark.parametrize("phase", list(P))
@pytest.mark.parametrize("event", list(HostEvent))
def test_every_transition_by_frames_and_calls(phase: HostPhase, event: HostEvent) -> None:
    desk = Desk()
    PREPARE[phase](desk)
    assert desk.host.phase is phase
    if phase not in ALLOWED.get(event, set(P)):
        with pytest.raises(ValueError, match=event.name):
            HAPPEN[event](desk)
        assert desk.host.phase is phase
        return
    HAPPEN[event](desk)
    assert desk.host.phase is EXPECTED[phase].get(event, phase)


def test_hfp_070_only_discover_before_an_identity() -> None:
    desk = Desk()
    assert desk.wait(300) == []
    desk.host.connect(desk.now_ns)
    for _ in range(3):
        desk.drive_heartbeat()
        desk.sample()
    desk.wait(301)
    assert desk.sent == [Discover(NODE)] * 4  # at once, and each 100 ms
    assert desk.setpoint(0) is None
    assert desk.host.take_samples() == []
    assert desk.host.counters["not_for_us"] == 9
    desk.hear(Identity(NODE, SERIAL, 1, 0))
    assert desk.phase() is P.READY
    assert desk.host.identity == Identity(NODE, SERIAL, 1, 0)
    assert desk.wait(1) == [0]


def test_connecting_twice_asks_no_faster() -> None:
    desk = Desk()
    for _ in range(50):
        desk.host.connect(desk.now_ns)
        desk.wait(1)
    assert desk.sent == [Discover(NODE)]


@pytest.mark.parametrize(
    ("major", "words"), [(0, "update the drive"), (2, "update the host"), (255, "update the host")]
)
def test_hfp_071_refusal_of_a_major_version(major: int, words: str) -> None:
    desk = Desk()
    desk.host.connect(desk.now_ns)
    desk.hear(Identity(NODE, SERIAL, major, 7))
    assert desk.phase() is P.REFUSED
    assert f"protocol {major}.7" in desk.host.refusal
    assert "1.0" in desk.host.refusal
    assert words in desk.host.refusal
    assert desk.wait(300) == []
    desk.host.connect(desk.now_ns)
    assert desk.host.refusal == ""


def test_hfp_071_a_heartbeat_of_another_version_ends_the_session() -> None:
    desk = Desk()
    desk.running()
    desk.drive_heartbeat(DriveState.OPERATIONAL, major=2)
    assert desk.phase() is P.REFUSED
    assert "protocol 2.0" in desk.host.refusal
    assert desk.setpoint(5) is None


@pytest.mark.parametrize("minor", [0, 1, 255])
def test_hfp_072_other_minor_versions_fit(minor: int) -> None:
    desk = Desk()
    desk.host.connect(desk.now_ns)
    desk.hear(Identity(NODE, SERIAL, 1, minor))
    assert desk.phase() is P.READY


@pytest.mark.parametrize(("serial", "phase"), [(SERIAL, P.READY), (SERIAL + 1, P.REFUSED)])
def test_hfp_073_expected_serial_number(serial: int, phase: HostPhase) -> None:
    desk = Desk(serial_number=SERIAL)
    desk.host.connect(desk.now_ns)
    desk.hear(Identity(NODE, serial, 1, 0))
    assert desk.host.phase is phase
    assert ("0xabcdef012346" in desk.host.refusal) == (phase is P.REFUSED)


def test_hfp_073_another_drive_later_on() -> None:
    desk = Desk()
    desk.running()
    desk.hear(Identity(NODE, SERIAL, 1, 0))
    assert desk.phase() is P.RUNNING
    desk.hear(Identity(NODE, SERIAL + 1, 1, 0))
    assert desk.phase() is P.REFUSED


@pytest.mark.parametrize("node", [1, 30])
def test_any_node_is_any_node(node: int) -> None:
    desk = Desk(node=0)
    desk.host.connect(desk.now_ns)
    desk.hear(Identity(node, 5, 1, 0))
    assert (desk.phase(), desk.host.node) == (P.READY, node)


def test_any_node_takes_the_first_that_answers() -> None:
    desk = Desk(node=0)
    assert desk.host.estop_frame() == codec.encode(Estop(0))
    with pytest.raises(ValueError, match="node"):
        desk.host.read_parameter(1)
    desk.identify()
    desk.hear(Identity(9, 5, 1, 0))
    assert (desk.host.phase, desk.host.node) == (P.READY, NODE)
    assert desk.host.estop_frame() == codec.encode(Estop(NODE))
    assert desk.wait(1) == [0]
    desk.wait(300)
    assert (desk.host.phase, desk.host.node) == (P.DISCONNECTED, 0)


@pytest.mark.parametrize(("quiet_ns", "phase"), [(-1, P.READY), (0, P.DISCONNECTED), (1, P.DISCONNECTED)])
@pytest.mark.parametrize("last", [Desk.sample, Desk.drive_heartbeat])
def test_hfp_074_silence(quiet_ns: int, phase: HostPhase, last: Callable[[Desk], None]) -> None:
    desk = Desk()
    desk.ready()
    desk.drive_heartbeat()
    desk.now_ns += 100 * MS
    last(desk)
    heard = desk.now_ns
    desk.now_ns += 100 * MS
    desk.host.receive(codec.encode_feedback(NODE, 1, 1, desk.n & 0xFF), desk.now_ns)  # old news
    desk.drive_heartbeat(advance=0)
    desk.host.receive(Frame(codec.encode_feedback(NODE, 1, 1, 1).arbitration_id, bytes(8)), desk.now_ns)
    desk.host.poll(heard + 250 * MS + quiet_ns)
    assert desk.host.phase is phase
    assert desk.host.counters["drive_gone"] == (phase is P.DISCONNECTED)


def test_parameter_answers_are_signs_of_life() -> None:
    desk = Desk()
    desk.ready()
    for _ in range(5):
        desk.wait(200)
        desk.hear(ParamResponse(NODE, ParamOp.OK, 1, 1))
    assert desk.phase() is P.READY


@pytest.mark.parametrize("prepare", [Desk.running, Desk.faulted])
def test_a_session_leaves_nothing_behind(prepare: Callable[[Desk], None]) -> None:
    """The next drive at this node may count and stamp as it likes, and has seen no heartbeat yet."""
    desk = Desk()
    prepare(desk)
    desk.drive_heartbeat(lost=9)
    desk.wait(300)
    host = desk.host
    assert desk.phase() is P.DISCONNECTED
    assert (host.identity, host.drive_state, host.fault) == (None, None, FaultReason.NONE)
    host.take_samples()
    before = host.counters["not_for_us"]
    desk.sample()
    desk.drive_heartbeat()
    assert host.counters["not_for_us"] == before + 3
    desk.heartbeat_sequence = 100
    desk.hear(Identity(NODE, SERIAL + 1, 1, 0))
    desk.host.connect(desk.now_ns)
    desk.hear(Identity(NODE, SERIAL + 1, 1, 0))
    desk.n = 0
    desk.sample()
    desk.drive_heartbeat(lost=3)
    desk.host.enable()
    assert desk.wait(22, DriveState.DISABLED) == [0, 0, 1]
    assert host.counters["stale_feedback"] == host.counters["stale_heartbeat"] == 0
    assert host.counters["drive_restarted"] == host.counters["lost_setpoints"] == 0
    assert len(host.take_samples()) == 23


def test_connecting_anew_asks_at_once() -> None:
    desk = Desk()
    desk.host.connect(desk.now_ns)
    desk.wait(1)
    desk.hear(Identity(NODE, SERIAL, 2, 0))
    desk.host.connect(desk.now_ns)
    desk.wait(1)
    assert desk.sent == [Discover(NODE)] * 2


def test_hfp_075_a_drive_that_restarts() -> None:
    desk = Desk()
    desk.running()
    desk.now_ns += MS
    for frame in (
        codec.encode_feedback(NODE, 0, 0, (desk.n + 1) & 0xFF),
        codec.encode_timing(NODE, 1, (desk.n + 1) & 0xFF, 0, 0, 0),
    ):
        desk.host.receive(frame, desk.now_ns)
    assert desk.phase() is P.DISCONNECTED
    assert desk.host.counters["drive_restarted"] == desk.host.counters["drive_gone"] == 1
    assert desk.host.drive_state is None


def test_hfp_080_heartbeats_each_period_and_at_each_change() -> None:
    desk = Desk()
    desk.ready()
    assert desk.wait(1, 0) == [0]
    assert desk.wait(19, 0) == []
    assert desk.wait(1, 0) == [0]
    desk.host.enable()
    assert desk.wait(1, 0) == [1]
    assert desk.wait(5, 1) == []
    desk.host.disable()
    assert desk.wait(1, 1) == [0]
    sequences = [m.sequence for m in desk.sent if isinstance(m, HostHeartbeat)]
    assert sequences == [1, 2, 3, 4]
    assert desk.host.counters["heartbeats_sent"] == 4


def test_hfp_087_enable_waits_until_low_was_seen() -> None:
    desk = Desk()
    desk.ready()
    desk.host.enable()
    assert desk.wait(41, 0) == [0, 0, 1]
    desk.sample(DriveState.ARMED)
    assert desk.phase() is P.ENABLING


def test_enable_waits_until_the_drive_let_go() -> None:
    """What is left of the last run must not pass for an answer to this one."""
    desk = Desk()
    desk.running()
    desk.host.disable()
    desk.host.enable()
    assert desk.wait(200, DriveState.OPERATIONAL) == [0] * 10
    assert desk.phase() is P.ENABLING
    assert desk.setpoint(5) is None
    assert desk.wait(1, DriveState.DISABLED) == [1]
    desk.sample(DriveState.OPERATIONAL)
    assert desk.phase() is P.RUNNING


@pytest.mark.parametrize(("ms", "phase"), [(999, P.ENABLING), (1_000, P.ENABLING), (1_001, P.READY)])
def test_enable_timeout(ms: int, phase: HostPhase) -> None:
    """It counts from the first poll after the call."""
    desk = Desk()
    desk.ready()
    desk.host.enable()
    desk.wait(ms, 0)
    assert desk.host.phase is phase
    assert desk.host.counters["enable_timeout"] == (phase is P.READY)
    if phase is P.READY:
        desk.host.enable()
        desk.wait(500, 0)
        assert desk.phase() is P.ENABLING


def test_hfp_100_and_101_references() -> None:
    desk = Desk()
    desk.ready()
    assert desk.setpoint(5) is None
    desk.host.enable()
    assert desk.setpoint(5) is None
    desk.wait(30, DriveState.DISABLED)
    assert desk.setpoint(5) is None
    for n in range(3):
        desk.sample(DriveState.ARMED, theta=1_000 + n)
        frame = desk.setpoint(5)
        assert frame == codec.encode(Setpoint(NODE, 1_000 + n, n + 1, desk.n & 0xFF))
    desk.sample(DriveState.OPERATIONAL, theta=2_000)
    assert desk.setpoint(2_005) == codec.encode(Setpoint(NODE, 2_005, 4, desk.n & 0xFF))
    desk.sample(DriveState.FAULT, FaultReason.WATCHDOG)
    assert desk.host.fault is FaultReason.WATCHDOG
    assert desk.setpoint(2_005) is None
    assert desk.host.counters["setpoints_sent"] == 4


def test_hfp_102_a_host_that_takes_no_samples_repeats_the_old_number() -> None:
    """So a drive drops its references as too old, though frames still come in."""
    desk = Desk()
    desk.running()
    assert desk.host.setpoint(5) is None
    taken = desk.host.take_samples()[-1]
    for n in range(50):
        desk.sample(DriveState.OPERATIONAL)
        assert desk.host.setpoint(5) == codec.encode(Setpoint(NODE, 5, n + 1, taken.sequence))
    assert desk.setpoint(5) == codec.encode(Setpoint(NODE, 5, 51, desk.n))


def test_what_is_left_of_the_last_session_is_no_base_for_a_reference() -> None:
    desk = Desk()
    desk.running()
    desk.wait(300)
    assert desk.phase() is P.DISCONNECTED
    assert len(desk.host.take_samples()) > 0
    desk.identify()
    desk.host.enable()
    assert desk.host.setpoint(5) is None


def test_references_wrap_and_number_on() -> None:
    desk = Desk()
    desk.running()
    for n in range(300):
        frame = desk.setpoint((5 << 32) + n)
        assert frame == codec.encode(Setpoint(NODE, n, (n + 1) & 0xFF, desk.n & 0xFF))


def test_fd_references() -> None:
    desk = Desk(fd=True)
    desk.ready()
    desk.host.enable()
    assert desk.host.take_samples() == []  # classic measurements are not for an FD host
    for n in range(60):
        desk.now_ns += MS
        state = DriveState.DISABLED if n < 50 else DriveState.OPERATIONAL
        desk.host.receive(codec.encode_fd_feedback(NODE, 5, 0, n * 1_000, n, 0, state, 0), desk.now_ns)
        desk.host.poll(desk.now_ns)
    assert desk.phase() is P.RUNNING
    assert desk.setpoint(6) == codec.encode(Setpoint(NODE, 6, 1, 59), fd=True)


def test_reset_is_one_pulse_and_ends_with_the_fault() -> None:
    desk = Desk()
    desk.faulted()
    desk.wait(40, DriveState.FAULT)
    desk.host.reset_fault()
    assert desk.wait(60, DriveState.FAULT) == [2, 2, 2, 0]
    assert desk.wait(60, DriveState.FAULT) == [0, 0, 0]
    desk.host.reset_fault()
    desk.host.reset_fault()
    assert desk.wait(30, DriveState.FAULT) == [2, 2]
    assert desk.wait(20, DriveState.DISABLED) == [0]
    assert desk.phase() is P.READY
    assert desk.host.fault is FaultReason.NONE
    desk.sample(DriveState.FAULT, FaultReason.SUPPLY)
    assert 2 not in desk.wait(100, DriveState.FAULT)  # an old wish is no wish


def test_faults_by_name_and_by_unknown_number() -> None:
    desk = Desk()
    desk.ready()
    desk.sample(DriveState.FAULT, FaultReason.INTERNAL)
    assert desk.host.counters["unknown_fault"] == 0
    desk.sample(DriveState.FAULT, 15)
    assert desk.host.fault is FaultReason.INTERNAL
    assert desk.host.counters["unknown_fault"] == 1
    (sample,) = desk.host.take_samples()[-1:]
    assert (sample.state, sample.fault) == (3, 15)


def test_dropping_out_is_counted() -> None:
    desk = Desk()
    desk.running()
    desk.sample(DriveState.DISABLED)
    assert desk.phase() is P.READY
    assert desk.host.counters["dropped_out"] == 1
    assert desk.wait(1, 0) == [0]


@pytest.mark.parametrize(("silence_ms", "believed"), [(49, False), (50, True)])
def test_heartbeats_say_the_state_only_when_samples_stay_away(silence_ms: int, believed: bool) -> None:
    desk = Desk()
    desk.running()
    desk.now_ns += silence_ms * MS
    desk.drive_heartbeat(DriveState.FAULT, FaultReason.SUPPLY)
    assert (desk.host.phase is P.FAULT) == believed


def test_a_heartbeat_alone_tells_a_fault() -> None:
    desk = Desk()
    desk.identify()
    desk.drive_heartbeat(DriveState.FAULT, FaultReason.ENCODER)
    assert (desk.host.phase, desk.host.fault) == (P.FAULT, FaultReason.ENCODER)
    for count, state in enumerate((4, 9, 15), start=1):
        desk.drive_heartbeat(state, 0)
        assert desk.host.counters["unknown_state"] == count
    assert desk.phase() is P.FAULT
    assert desk.setpoint(1) is None


@pytest.mark.parametrize(("advance", "stale"), [(0, True), (1, False), (127, False), (128, True), (255, True)])
def test_stale_drive_heartbeats(advance: int, stale: bool) -> None:
    desk = Desk()
    desk.identify()
    desk.drive_heartbeat(lost=250)
    desk.drive_heartbeat(DriveState.FAULT, FaultReason.SUPPLY, lost=4, advance=advance)
    assert (desk.host.phase is P.READY) == stale
    assert desk.host.counters["stale_heartbeat"] == stale
    assert desk.host.counters["lost_setpoints"] == (0 if stale else 10)
    assert desk.host.counters["rejected_by_drive"] == 3


def test_bench_and_parameters() -> None:
    desk = Desk()
    desk.ready()
    desk.hear(BenchSensor(NODE, 5, -6, 7))
    (bench,) = desk.host.take_bench()
    assert bench == (7, 5, -6, desk.now_ns)
    assert desk.host.read_parameter(0x0201) == codec.encode(ParamRequest(NODE, ParamOp.READ, 0x0201, 0))
    assert desk.host.write_parameter(0x0201, 9) == codec.encode(ParamRequest(NODE, ParamOp.WRITE, 0x0201, 9))
    for value in range(70):
        desk.hear(ParamResponse(NODE, ParamOp.OK, 0x0201, value))
    assert [answer.value for answer in desk.host.take_responses()] == list(range(6, 70))
    assert desk.host.take_responses() == []
    assert desk.host.counters["responses_overflow"] == 6


def test_what_others_say_and_our_own_echo_are_nothing() -> None:
    desk = Desk()
    desk.ready()
    before = dict(desk.host.counters)
    desk.hear(DriveHeartbeat(5, 3, 3, 2, 0, 0, 0, 0))
    desk.hear(Identity(5, 1, 2, 0))
    desk.hear(HostHeartbeat(NODE, 1, 1, 0, 0))
    desk.hear(Setpoint(NODE, 1, 1, 0))
    assert desk.phase() is P.READY
    assert desk.host.counters == {**before, "not_for_us": before["not_for_us"] + 4}


def test_damaged_frames_are_counted() -> None:
    desk = Desk()
    desk.ready()
    good = codec.encode_feedback(NODE, 1, 2, 3)
    desk.host.receive(good._replace(data=good.data[:-1] + b"\xff"), desk.now_ns)
    assert desk.host.counters["bad_crc"] == 1


@pytest.mark.parametrize(
    "wrong",
    [{"node": 31}, {"node": -1}, {"heartbeat_period_ns": 0}, {"drive_timeout_ns": -1}, {"enable_timeout_ns": 0}],
)
def test_config_is_checked(wrong: dict[str, int]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        HostConfig(**{"node": 1, **wrong})  # type: ignore[arg-type]
    HostConfig(node=0, heartbeat_period_ns=1)
    HostConfig(node=30)


def test_frames_of_the_drive_with_29_bits_are_somebody_elses() -> None:
    desk = Desk()
    desk.ready()
    host = desk.host
    host.take_samples()
    before = dict(host.counters)
    for frame in (codec.encode_feedback(NODE, 1, 2, 3), codec.encode_timing(NODE, 5, 3, 0, 0, 0)):
        host.receive(frame._replace(is_extended=True), desk.now_ns)
    assert host.take_samples() == []
    assert host.counters == {**before, "not_for_us": before["not_for_us"] + 2}
