"""Who is on a bus, by listening: each kind of drive is told, nothing else is taken for one, nothing is sent."""

import math
from pathlib import Path

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol import codec
from firmware_protocol.frames import Frame
from firmware_protocol.messages import DriveHeartbeat, Feedback
from hil_forceps.cli import main as cli
from hil_forceps.drives.profile import Found
from hil_forceps.drives.registry import PROFILES
from hil_forceps.drives.scan import BusListener
from hil_forceps.rig import load_rig
from virtual_bus.drives.moteus import SimulatedMoteus
from virtual_bus.plant.load import paper_load

CONFIGS = Path(__file__).parents[3] / "configs"


def heard(*frames: Frame) -> list[Found]:
    listener = BusListener()
    for frame in frames:
        listener.receive(frame)
    return listener.found()


def scan(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    with pytest.raises(SystemExit) as ended:
        cli.main(["scan", *arguments])
    return int(ended.value.code or 0), capsys.readouterr().out


@pytest.mark.parametrize(
    ("rig", "row"),
    [
        ("realistic.yaml", ("native", "1", "disabled; protocol 1.0")),
        ("drives/odrive.yaml", ("odrive", "5", "idle; sends encoder estimates and Iq")),
        ("drives/cia402.yaml", ("cia402", "5", "just booted")),
        ("drives/vesc.yaml", ("vesc", "5", "broadcasts STATUS")),
    ],
)
def test_each_simulated_drive_is_told(rig: str, row: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    channel = ("--interface", "virtual_forceps", "--channel", rig, "--option", f"rig={CONFIGS / rig}")
    code, out = scan(capsys, *channel)
    assert code == 0
    (line,) = [line for line in out.splitlines() if line.strip().startswith(row[0])]
    assert line.split()[1] == row[1]
    assert row[2] in line


@pytest.mark.parametrize(
    ("profile", "more", "says"),
    [
        ("odrive", (), "idle; sends encoder estimates and Iq"),
        ("cia402", (), "just booted"),
        ("vesc", (), "broadcasts STATUS"),
        ("moteus", ("--ask", "moteus"), "stopped; answers, and sends nothing unasked"),
        ("dynamixel", ("--ask", "dynamixel"), "XM430-W350"),
    ],
)
def test_on_a_bus_with_fd_drives_of_every_profile_are_found(
    profile: str, more: tuple[str, ...], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = f"rig={CONFIGS / 'drives' / f'{profile}.yaml'}"
    channel = ("--interface", "virtual_forceps", "--channel", f"fd {profile}", "--option", rig)
    code, out = scan(capsys, *channel, *more, "--fd")
    assert code == 0
    (line,) = [line for line in out.splitlines() if line.strip().startswith(profile)]
    assert line.split()[1] == "5"
    assert says in line


def test_a_moteus_is_heard_on_a_bus_with_fd_where_another_program_asks_it(capsys: pytest.CaptureFixture[str]) -> None:
    rig = CONFIGS / "drives" / "moteus.yaml"
    with can.Bus(interface="virtual_forceps", channel="busy", rig=str(rig)) as other:
        for _ in range(2):
            other.send(can.Message(arbitration_id=0x8005, data=bytes.fromhex("1100110f"), is_fd=True, dlc=4))
        code, out = scan(capsys, "--interface", "virtual_forceps", "--channel", "busy", "--fd")
    assert code == 0
    assert "stopped; answers, and sends nothing unasked" in out


def test_a_moteus_is_asked_what_moves_nothing_and_changes_nothing() -> None:
    rig = load_rig(CONFIGS / "drives" / "moteus.yaml")
    drive = SimulatedMoteus(rig, paper_load(0))
    drive.receive(PROFILES["moteus"].ask[0], 1_000_000)
    assert [frame.arbitration_id for frame in drive.take_outbox()] == [0x500]
    assert (drive.mode, drive.fault, math.isnan(drive._left_s)) == (0, 0, True)
    assert PROFILES["moteus"].ask[0].data == bytes.fromhex("1100110f")  # the maker's own example


def test_a_drive_on_a_can_bus_is_not_asked_over_a_serial_line(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main(["scan", "--serial", "/dev/null", "--ask", "moteus"])
    assert ended.value.code == 2
    assert "--ask moteus: this drive is on a CAN bus" in capsys.readouterr().err


def test_a_moteus_says_nothing_by_itself(capsys: pytest.CaptureFixture[str]) -> None:
    rig = f"rig={CONFIGS / 'drives' / 'moteus.yaml'}"
    code, out = scan(capsys, "--interface", "virtual_forceps", "--channel", "moteus", "--option", rig)
    assert code == 1
    assert "no frame was received" in out


def test_a_moteus_is_told_by_its_answers_to_somebody_else() -> None:
    """Two, in frames of CAN FD whose ids have as many bits as they need; nobody else's look like them."""
    reply = bytes.fromhex("21000a 2e01 0000803f 00000000 210f00 5050".replace(" ", "")).ljust(20, b"\x50")
    timeout = bytes.fromhex("24040b000000000000002300000000 50".replace(" ", ""))
    base, wide = Frame(0x500, reply, True), Frame(0x800, timeout, True, True)
    assert heard(base, base, wide, wide) == [
        ("moteus", 5, "position; answers, and sends nothing unasked"),
    ]
    fault = Frame(0x800, bytes.fromhex("2100012 10f21".replace(" ", "")), True, True)
    assert heard(fault, fault) == [
        ("moteus", 8, "fault 33 (motor driver fault, often under voltage); answers, and sends nothing unasked")
    ]
    for other in (
        base._replace(is_fd=False, data=reply[:8]),
        base._replace(is_extended=True),
        wide._replace(is_extended=False, arbitration_id=0x7FF),
        base._replace(data=reply[:12]),
        base._replace(data=b"\x21\x00\x63" + reply[3:]),
        Frame(0x8005, reply, True, True),
        Frame(0x8005, bytes.fromhex("1100110f"), True, True),
    ):
        assert heard(other, other) == []


def test_a_servo_that_says_nothing_by_itself_is_asked_by_a_ping(capsys: pytest.CaptureFixture[str]) -> None:
    rig = f"rig={CONFIGS / 'drives' / 'dynamixel.yaml'}"
    channel = ("--interface", "virtual_forceps", "--channel", "asked", "--option", rig)
    code, out = scan(capsys, *channel, "--seconds", "0.2")
    assert code == 1
    assert "no frame was received" in out
    code, out = scan(capsys, *channel, "--seconds", "0.2", "--ask", "dynamixel")
    assert code == 0
    assert [line.split() for line in out.splitlines() if "XM430" in line] == [
        ["dynamixel", "5", "XM430-W350,", "firmware", "45"]
    ]


def test_a_drive_that_tells_by_itself_is_not_asked(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main(["scan", "--interface", "virtual", "--ask", "odrive"])
    assert ended.value.code == 2
    assert "--ask odrive: this profile has no read-only request" in capsys.readouterr().err


def test_what_a_ping_brings_is_told_also_of_servos_that_are_not_known() -> None:
    listener = BusListener(PROFILES["dynamixel"])
    for frame in (
        Frame(7, bytes.fromhex("5580240426")),
        Frame(3, bytes.fromhex("5500060426")),
        Frame(9, bytes.fromhex("550006")),
        Frame(254, bytes.fromhex("01")),
    ):
        listener.receive(frame)
    assert listener.frames == 4
    assert listener.found() == [
        Found("dynamixel", 3, "XM430-W210, firmware 38"),
        Found(
            "dynamixel",
            7,
            "unknown model number 1060, firmware 38; alerts: Hardware Error Status (70) has the error",
        ),
    ]
    assert heard(Frame(3, bytes.fromhex("5500060426"))) == []  # on a CAN bus that may be anybody's


def test_nobody_is_an_answer_of_its_own(capsys: pytest.CaptureFixture[str]) -> None:
    # Too short for an ODrive's second heartbeat.
    rig = f"rig={CONFIGS / 'drives' / 'odrive.yaml'}"
    code, out = scan(
        capsys, "--interface", "virtual_forceps", "--channel", "short", "--option", rig, "--seconds", "0.05"
    )
    assert code == 1
    assert "no drive recognised in 0.05 s" in out
    assert "none of them a heartbeat of a known drive" in out


def test_a_drive_that_only_answers_is_not_heard_and_that_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    rig = f"rig={CONFIGS / 'drives' / 'mit.yaml'}"
    code, out = scan(capsys, "--interface", "virtual_forceps", "--channel", "mit", "--option", rig)
    assert code == 1
    assert "A mini cheetah drive (mit) sends nothing unasked" in out


@pytest.mark.parametrize("seconds", ["0", "-1", "nan", "1e9"])
def test_how_long_is_checked(seconds: str) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main(["scan", "--interface", "virtual", "--seconds", seconds])
    assert ended.value.code == 2


def test_an_odrive_that_sends_no_current_is_told_so() -> None:
    beat = Frame(5 << 5 | 1, bytes.fromhex("0000000101000000"))
    (found,) = heard(beat, beat)
    assert found == (
        "odrive",
        5,
        "idle; axis error 0x1000000; sends no encoder estimates and no Iq: set its cyclic messages",
    )


def test_a_frame_of_ours_is_no_heartbeat_of_an_odrive() -> None:
    feedback = codec.encode(Feedback(1, 0, 0, 0))  # 081: an ODrive's node 4 would beat there
    assert heard(feedback, feedback, feedback) == []
    beat = codec.encode(DriveHeartbeat(3, 0, 0, 1, 0, 0, 0, 0))
    assert [(found.profile, found.node) for found in heard(beat)] == [("native", 3)]


def test_a_vesc_is_told_by_what_it_broadcasts() -> None:
    status = Frame(0x905, bytes.fromhex("00000000fffe0000"), is_extended=True)
    assert heard(status) == []  # one frame may be anybody's
    assert heard(status, status) == [("vesc", 5, "broadcasts STATUS; 0.2 A; it reports its state only on request")]
    assert heard(*[status._replace(is_extended=False)] * 2) == []
    assert heard(*[status._replace(arbitration_id=0x8000905)] * 2) == []
    assert heard(*[status._replace(data=bytes(7))] * 2) == []


@pytest.mark.parametrize("frame", [Frame(0x700, b"\x05"), Frame(0x705, b"\x06"), Frame(0x705, b"\x05\x00")])
def test_what_is_no_heartbeat_of_canopen(frame: Frame) -> None:
    assert heard(frame, frame) == []


@given(st.lists(st.tuples(st.integers(0, 0x7FF), st.binary(max_size=64)), max_size=30))
def test_whatever_comes_nothing_raises(frames: list[tuple[int, bytes]]) -> None:
    heard(*(Frame(arbitration_id, data, len(data) > 8) for arbitration_id, data in frames))


def test_ids_with_29_bits_are_of_none_that_has_11() -> None:
    frames = [
        codec.encode(DriveHeartbeat(3, 0, 0, 1, 0, 0, 0, 0)),
        *[Frame(5 << 5 | 1, bytes.fromhex("0000000101000000"))] * 2,
        Frame(0x705, b"\x05"),
    ]
    assert {found.profile for found in heard(*frames)} == {"native", "odrive", "cia402"}
    assert heard(*(frame._replace(is_extended=True) for frame in frames)) == []
