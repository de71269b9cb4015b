"""The CiA 402 profile's set-up: one request at a time, what is refused, restarts and faults in between."""

import math
import struct

import pytest

from firmware_protocol.frames import Frame
from firmware_protocol.states import HostPhase
from hil_forceps.drives.cia402 import messages as wire
from hil_forceps.drives.cia402.machine import Cia402
from hil_forceps.drives.cia402.messages import State
from hil_forceps.drives.cia402.objects import HOST_NODE
from hil_forceps.drives.cia402.setup import SDO_TIMEOUT_NS
from tests.unit.drives.cia402.bench import CONFIG, MS, NODE, answer, boot_up, current, position, set_up, tick


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
    assert "not a CiA 402 drive: its device type has the profile 401" in drive.refusal


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
