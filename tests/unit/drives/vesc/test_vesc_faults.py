"""The VESC profile's faults, restarts and silence, and another program that commands the drive."""

import struct

from firmware_protocol.frames import Frame
from firmware_protocol.messages import DriveState
from firmware_protocol.states import HostPhase
from hil_forceps.drives.vesc.machine import SILENCE_NS
from tests.unit.drives.vesc.bench import MS, NODE, SET_CURRENT, Bench, answer, command


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
