"""The moteus profile: asking, enabling, references that feed the watchdog, samples."""

import math
import struct
from pathlib import Path
from typing import Any

import pytest

from firmware_protocol.frames import Frame
from firmware_protocol.messages import DriveState
from firmware_protocol.scales import ANGLE_LSB_PER_REV, CURRENT_LSB_A
from hil_forceps.drives.moteus.machine import IDENTIFY_EVERY_NS, Moteus
from hil_forceps.drives.moteus.messages import Mode
from hil_forceps.drives.moteus.subframes import parse_subframes
from hil_forceps.drives.registry import machine_for
from hil_forceps.rig import load_rig
from tests.unit.drives.moteus.bench import CONFIG, IDENTITY, MODE_AND, MS, NODE, Session, answer, commands

RIG_FILE = Path(__file__).parents[4] / "configs" / "drives" / "moteus.yaml"


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
            "register map version 4 (firmware 0.1.3), but version 5",
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
    assert f"is already in mode {mode.value}," in session.drive.refusal
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
