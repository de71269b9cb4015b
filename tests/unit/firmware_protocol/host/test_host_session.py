"""A host's session: identity, versions, silence and restarts (HFP-070 to HFP-075)."""

from collections.abc import Callable

import pytest

from firmware_protocol import codec
from firmware_protocol.frames import Frame
from firmware_protocol.host.machine import HostPhase
from firmware_protocol.messages import (
    Discover,
    DriveState,
    Estop,
    FaultReason,
    Identity,
    ParamOp,
    ParamResponse,
)
from tests.unit.firmware_protocol.host.desk import MS, NODE, SERIAL, Desk, P


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
