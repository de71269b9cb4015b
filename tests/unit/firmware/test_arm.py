"""The example image for an STM32F405 under Unicorn: it does what Python does, at the cost that the guide says."""

import random
import re

import pytest

from firmware_protocol import codec
from firmware_protocol.frames import Frame
from firmware_protocol.messages import AssignNode, Discover, DriveState, Estop, FaultReason
from tests.firmware_library import SOURCES
from tests.firmware_stm32 import SERIAL, Session, figures, ideal_device

GUIDE = SOURCES.parents[1] / "docs" / "porting.md"


def test_the_object_code_does_what_python_does() -> None:
    """Enabling, following, parameters; then a node assigned, discovery, the watchdog, ESTOP: each frame compared."""
    session = Session()
    session.run(40)
    session.turn("estop", codec.encode(Estop(1)))
    assert session.drive.fault is FaultReason.ESTOP
    assert session.device.dac == 2048
    session.turn("reset", session.heartbeat(0))
    session.turn("reset", session.heartbeat(2))
    assert session.drive.state is DriveState.DISABLED
    session.turn("discover", codec.encode(Discover(0)))
    for _ in range(140):
        session.turn("nothing")
    session.turn("assign", codec.encode(AssignNode(0, SERIAL, 9)))
    assert [session.device.can.passes(identifier) for identifier in (0x109, 0x000, 0x101, 0x11F)] == [1, 1, 0, 0]
    session.turn("discover", codec.encode(Discover(9)))
    for _ in range(140):
        session.turn("nothing")
    assert session.compared > 250


def test_the_watchdog_takes_the_current_away() -> None:
    session = Session()
    session.run(3)
    for _ in range(100):
        session.turn("nothing")
    assert session.drive.fault is FaultReason.WATCHDOG
    assert session.device.dac == 2048


def test_frames_at_random() -> None:
    session, rng = Session(), random.Random(4)
    session.run(2)
    for _ in range(300):
        identifier = rng.choice((1, 0)) | rng.choice((0x02, 0x08, 0x10, 0x18, 0x1A, rng.randrange(0x40))) << 5
        session.turn("random", Frame(identifier, rng.randbytes(rng.choice((8, 8, 8, 0, 3)))))
    assert session.drive.rejected() > 100


def test_the_encoder_is_counted_past_its_sixteen_bits() -> None:
    device = ideal_device()
    for i in range(20):
        device.encoder += 9_000
        device.turn(1_000 * i)
    assert int.from_bytes(device.can.sent[-2].data[:4], "little") == 180_000 * 1024


def test_the_guide_says_what_it_costs() -> None:
    """Within a tenth: compilers differ."""
    said = {
        name: int(value.replace(",", ""))
        for name, value in re.findall(r"^\| ([A-Za-z0-9 ,-]+?) \| ([\d,]+) ", GUIDE.read_text(), re.M)
    }
    measured = figures()
    assert said.keys() == measured.keys()
    for name, value in measured.items():
        assert said[name] == pytest.approx(value, rel=0.1), name
