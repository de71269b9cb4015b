"""The drive that answers, beside a rig: simulated drives with planted mistakes, and nothing that is sent moves one."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol import codec
from firmware_protocol.drive import machine as drive_machine
from firmware_protocol.frames import Frame
from firmware_protocol.messages import PROTOCOL_MAJOR, DriveState, Estop, Function, Identity
from hil_forceps.bridge.clocks import VirtualClock
from hil_forceps.bridge.doctor import drive, timing
from hil_forceps.bridge.doctor.check import Check, Verdict
from hil_forceps.bridge.links.adapters import Connection
from hil_forceps.bridge.links.can_link import VirtualTimeLink
from hil_forceps.bridge.ports import SendResult
from hil_forceps.drives.inquiry import Said
from hil_forceps.drives.registry import inquiry_for
from hil_forceps.rig import Rig, load_rig
from virtual_bus.bus.node import Node
from virtual_bus.drive import SimulatedDrive
from virtual_bus.drives.cia402 import ENABLED, SimulatedCia402
from virtual_bus.drives.dynamixel import OVERLOAD, SimulatedDynamixel
from virtual_bus.drives.moteus import SimulatedMoteus
from virtual_bus.drives.odrive import SimulatedODrive
from virtual_bus.drives.registry import SIMULATED_DRIVES
from virtual_bus.drives.vesc import UNDER_VOLTAGE, SimulatedVesc
from virtual_bus.interface import VirtualForcepsBus
from virtual_bus.plant.load import paper_load

CONFIGS = Path(__file__).parents[4] / "configs"
NAMES = ("odrive", "cia402", "moteus", "vesc", "dynamixel", "mit")


def rig_of(name: str, *changes: tuple[str, str], folder: Path | None = None) -> Rig:
    path = CONFIGS / ("realistic.yaml" if name == "native" else f"drives/{name}.yaml")
    if not changes:
        return load_rig(path)
    assert folder is not None
    text = path.read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    changed = folder / "changed.yaml"
    changed.write_text(text, encoding="utf-8")
    return load_rig(changed)


def simulated(name: str, rig: Rig | None = None) -> Any:
    rig = rig or rig_of(name)
    return SimulatedDrive(rig, paper_load(0)) if name == "native" else SIMULATED_DRIVES[name](rig, paper_load(0))


class Watched(VirtualTimeLink):
    """A link that keeps what is sent."""

    def __init__(self, bus: VirtualForcepsBus) -> None:
        super().__init__(bus)
        self.sent: list[Frame] = []

    def send(self, frame: Frame) -> SendResult:
        self.sent.append(frame)
        return super().send(frame)


def looked(rig: Rig, *nodes: Node) -> tuple[dict[str, Check], list[Frame]]:
    """Return the checks of a rig's drive on a bus with these nodes, and the frames that were sent."""
    bus = VirtualForcepsBus(f"doctor {id(nodes)}", nodes=nodes, fd=rig.bench.transport == "fd")
    link = Watched(bus)
    inquiry = inquiry_for(rig)
    try:
        heard = drive.listen(Connection(link, VirtualClock(bus), True, ()), [inquiry], [rig])
    finally:
        link.close()
    checks = [drive.cannot_ask(rig)] if inquiry is None else drive.checks(rig, heard.said[0], heard)
    found = {check.id: check for check in checks}
    told_s = None if heard.said[0] is None else heard.said[0].watchdog_s
    found["timing.watchdog"] = timing.watchdog(told_s, "by the drive", rig.bench.host_period_s, 0.0)
    return found, link.sent


@pytest.mark.parametrize("name", ["native", *NAMES])
def test_a_drive_that_is_as_its_rig_says_is_well(name: str) -> None:
    found, _ = looked(rig_of(name), simulated(name))
    assert {check.verdict for check in found.values()} <= {Verdict.OK, Verdict.UNKNOWN}
    if name != "mit":
        assert found["drive.answers"].verdict is found["drive.fault"].verdict is Verdict.OK
    if name == "native":
        assert {check.id for check in found.values() if check.verdict is Verdict.UNKNOWN} == {"drive.current_limit"}


def test_nothing_that_is_sent_moves_feeds_or_changes_anything() -> None:
    native = {f.arbitration_id >> 5 for f in looked(rig_of("native"), simulated("native"))[1]}
    assert native == {Function.DISCOVER, Function.PARAM_REQUEST}
    assert all(f.data[0] == 0 for f in looked(rig_of("native"), simulated("native"))[1] if f.data)  # READ
    assert looked(rig_of("odrive"), simulated("odrive"))[1] == []
    assert looked(rig_of("mit"), simulated("mit"))[1] == []
    uploads = looked(rig_of("cia402"), simulated("cia402"))[1]
    assert uploads
    assert {(f.arbitration_id, f.data[0]) for f in uploads} == {(0x605, 0x40)}
    (query,) = looked(rig_of("moteus"), simulated("moteus"))[1]
    assert query.data[0] >> 4 == 1  # reads; a write would begin with 0x0
    (request,) = looked(rig_of("vesc"), simulated("vesc"))[1]
    assert request.arbitration_id == 8 << 8 | 5
    assert request.data[2] == 50
    assert looked(rig_of("dynamixel"), simulated("dynamixel"))[1] == [Frame(254, b"\x01")]


def test_a_simulated_drive_stands_behind_it_as_before() -> None:
    odrive, cia402, vesc, moteus = (simulated(name) for name in ("odrive", "cia402", "vesc", "moteus"))
    objects = dict(cia402.objects)
    for name, node in (("odrive", odrive), ("cia402", cia402), ("vesc", vesc), ("moteus", moteus)):
        looked(rig_of(name), node)
        assert node.counters["not_understood"] == 0
    assert (odrive.state, odrive.modes, odrive._fed_ns) == (1, (0, 0), 0)
    shown = {0x6064, 0x6041, 0x6061, 0x30D1, 0x6077, 0x6078}  # what is measured
    assert {k: v for k, v in cia402.objects.items() if k[0] not in shown} == {
        k: v for k, v in objects.items() if k[0] not in shown
    }
    assert vesc.has_timeout
    assert vesc._fed_ns is None
    assert moteus.mode == 0


@pytest.mark.parametrize("name", ["native", *(name for name in NAMES if name != "mit")])
def test_another_node_is_told_by_what_to_set(name: str, tmp_path: Path) -> None:
    old = ("bench:\n", "bench:\n  node_id: 7\n") if name == "native" else ("node_id: 5", "node_id: 7")
    found, _ = looked(rig_of(name, old, folder=tmp_path), simulated(name))
    check = found["drive.answers"]
    assert check.verdict is Verdict.FAIL
    assert check.remedy
    assert "drive.fault" not in found
    if name in {"native", "odrive", "cia402", "dynamixel", "vesc"}:  # a moteus says nothing by itself
        assert f"set {'bench' if name == 'native' else 'motor_driver'}.node_id: {1 if name == 'native' else 5}" in (
            check.remedy
        )


def test_another_kind_of_drive_is_told() -> None:
    check = looked(rig_of("native"), simulated("odrive"))[0]["drive.answers"]
    assert check.verdict is Verdict.FAIL
    assert "odrive 5" in check.text
    assert "no frame was received" in looked(rig_of("native"))[0]["drive.answers"].text


@pytest.mark.parametrize(
    ("name", "changes", "check_id", "text"),
    [
        (
            "native",
            ("counts_per_rev: 16384", "counts_per_rev: 4096"),
            "drive.counts",
            "the drive has 16384, the rig 4096",
        ),
        ("native", ("counts_per_rev: 16384", "counts_per_rev: ideal"), "drive.counts", "the rig an ideal encoder"),
        ("cia402", ("counts_per_rev: 16384", "counts_per_rev: 4096"), "drive.counts", "the drive has 16384"),
        ("dynamixel", ("counts_per_rev: 4096", "counts_per_rev: 16384"), "drive.counts", "the drive has 4096"),
        ("native", ("feedback_divider: 2", "feedback_divider: 1"), "drive.sample_period", "1 ms, the rig's 0.5 ms"),
        ("odrive", ("feedback_period_s: 1.0e-3", "feedback_period_s: 2.0e-3"), "drive.sample_period", "the rig's 2 ms"),
        ("native", ("position_max_rad: 1.6", "position_max_rad: 1.7"), "drive.range", "the rig allows -0.5 to 1.7"),
        ("native", ("position_min_rad: -0.5", "position_min_rad: -0.6"), "drive.range", "the rig allows -0.6"),
        ("native", ("transport: classic", "transport: fd"), "drive.transport", "the drive has classic"),
        (
            "native",
            ("host_period_s: 1.0e-3", "host_period_s: 1.0e-2"),
            "timing.watchdog",
            "20 ms by the drive, 2.0 peri",
        ),
        (
            "cia402",
            ("current_limit_A: 1.0", "current_limit_A: 0.5"),
            "drive.current_limit",
            "the motor can give more torque",
        ),
    ],
)
def test_a_rig_that_is_another_drives_fails(
    name: str, changes: tuple[str, str], check_id: str, text: str, tmp_path: Path
) -> None:
    check = looked(rig_of(name, changes, folder=tmp_path), simulated(name))[0][check_id]
    assert check.verdict is Verdict.FAIL
    assert text in check.text
    assert check.remedy


@pytest.mark.parametrize(
    ("name", "changes", "check_id"),
    [
        (
            "native",
            ("torque_constant_N_m_per_A: 1.35e-2", "torque_constant_N_m_per_A: 1.5e-2"),
            "drive.torque_constant",
        ),
        ("cia402", ("current_limit_A: 1.0", "current_limit_A: 2.0"), "drive.current_limit"),
    ],
)
def test_what_only_makes_results_worse_is_warned_of(
    name: str, changes: tuple[str, str], check_id: str, tmp_path: Path
) -> None:
    check = looked(rig_of(name, changes, folder=tmp_path), simulated(name))[0][check_id]
    assert check.verdict is Verdict.WARN
    assert check.remedy


def test_a_native_drive_of_another_version_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drive_machine, "PROTOCOL_MAJOR", 2)
    found, sent = looked(rig_of("native"), simulated("native"))
    check = found["drive.version"]
    assert (check.verdict, check.remedy) == (Verdict.FAIL, "update the host")
    assert "protocol 2.0" in check.text
    assert {frame.arbitration_id >> 5 for frame in sent} == {Function.DISCOVER}


def test_no_parameter_is_asked_of_a_drive_whose_identity_does_not_fit() -> None:
    inquiry = inquiry_for(rig_of("native"))
    assert inquiry is not None
    assert [frame.arbitration_id >> 5 for frame in inquiry.poll(0)] == [Function.DISCOVER]
    inquiry.receive(codec.encode(Identity(1, 7, PROTOCOL_MAJOR + 1, 0)), 1)
    assert inquiry.poll(10**9) == []
    fitting = inquiry_for(rig_of("native"))
    assert fitting is not None
    fitting.receive(codec.encode(Identity(1, 7, PROTOCOL_MAJOR, 0)), 1)
    assert [frame.arbitration_id >> 5 for frame in fitting.poll(10**9)] == [Function.PARAM_REQUEST]


def old_servo() -> SimulatedDynamixel:
    servo = SimulatedDynamixel(rig_of("dynamixel"), paper_load(0))
    servo.table.put(6, 37)
    return servo


def other_servo() -> SimulatedDynamixel:
    servo = SimulatedDynamixel(rig_of("dynamixel"), paper_load(0))
    servo.table.put(0, 1060)
    return servo


def other_device() -> SimulatedCia402:
    device = SimulatedCia402(rig_of("cia402"), paper_load(0))
    device.objects[0x1000, 0] = 401
    return device


@pytest.mark.parametrize(
    ("name", "make", "text"),
    [
        ("moteus", lambda: SimulatedMoteus(rig_of("moteus"), paper_load(0), register_map=4), "registers 4"),
        ("vesc", lambda: SimulatedVesc(rig_of("vesc"), paper_load(0), has_status_bit=False), "before 5.03"),
        ("dynamixel", old_servo, "firmware 37"),
        ("dynamixel", other_servo, "model number 1060"),
        ("cia402", other_device, "device profile is 401"),
    ],
)
def test_a_makers_drive_of_another_version_fails(name: str, make: Callable[[], Node], text: str) -> None:
    check = looked(rig_of(name), make())[0]["drive.version"]
    assert check.verdict is Verdict.FAIL
    assert text in check.text
    assert check.remedy


def faulty(name: str) -> Any:
    node = simulated(name)
    if isinstance(node, SimulatedDrive):
        node.receive(codec.encode(Estop(1)), 0)
    elif isinstance(node, SimulatedODrive | SimulatedCia402):
        node.trip()
    elif isinstance(node, SimulatedMoteus):
        node.fail(33)
    elif isinstance(node, SimulatedVesc):
        node.fail(UNDER_VOLTAGE, 0)
    elif isinstance(node, SimulatedDynamixel):
        node.fail(OVERLOAD)
    return node


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("native", "ESTOP (emergency stop)"),
        ("odrive", "missing input"),
        ("cia402", "error code 0x8110"),
        ("moteus", "fault 33"),
        ("vesc", "fault 2 (under voltage)"),
        ("dynamixel", "Hardware Error Status (70)"),
    ],
)
def test_a_drive_in_a_fault_says_so(name: str, words: str) -> None:
    check = looked(rig_of(name), faulty(name))[0]["drive.fault"]
    assert check.verdict is Verdict.FAIL
    assert words in check.text
    assert "--reset-fault" in check.remedy


def test_a_drive_that_another_program_moves_fails() -> None:
    node = simulated("cia402")
    node.status = ENABLED
    assert looked(rig_of("cia402"), node)[0]["drive.state"].verdict is Verdict.FAIL
    said = Said(state=DriveState.ARMED)
    checks = {check.id: check for check in drive.checks(rig_of("native"), said, drive.Heard((said,), (), 1))}
    assert checks["drive.state"].verdict is Verdict.FAIL
    assert {check.verdict for name, check in checks.items() if name not in {"drive.state", "drive.answers"}} == {
        Verdict.UNKNOWN
    }


@given(
    st.sampled_from(["native", *(name for name in NAMES if name != "mit")]),
    st.lists(
        st.builds(
            Frame,
            st.sampled_from([0x121, 0x221, 0x321, 0xA1, 0xA9, 0x585, 0x705, 0x500, 0x5FD, 0x7FD, 5])
            | st.integers(0, 0x7FF),
            st.binary(max_size=64),
            st.booleans(),
            st.booleans(),
        ),
        max_size=20,
    ),
)
def test_no_frame_raises(name: str, frames: list[Frame]) -> None:
    rig = rig_of(name)
    inquiry = inquiry_for(rig)
    assert inquiry is not None
    for at, frame in enumerate(frames):
        inquiry.poll(at * 60_000_000)
        inquiry.receive(frame, at * 60_000_000)
    said = inquiry.said()
    for check in drive.checks(rig, said, drive.Heard((said,), (), len(frames))):
        assert isinstance(check.verdict, Verdict)


def test_a_line_without_a_rig_is_listened_to() -> None:
    bus = VirtualForcepsBus("doctor listens", nodes=[simulated("native")])
    link = Watched(bus)
    heard = drive.listen(Connection(link, VirtualClock(bus), True, ()), [], [])
    link.close()
    assert link.sent == []
    check = drive.who_is_there(heard)
    assert (check.verdict, check.value) == (Verdict.OK, 1.0)
    assert "native 1: disabled" in check.text
    assert drive.who_is_there(drive.Heard((), (), 0)).verdict is Verdict.WARN
