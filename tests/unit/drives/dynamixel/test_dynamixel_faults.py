"""The Dynamixel profile's faults: told in words, reset, and restarts that are noticed."""

import pytest

from firmware_protocol.messages import DriveState
from firmware_protocol.states import HostPhase
from tests.unit.drives.dynamixel.bench import Bench, running
from virtual_bus.drives.dynamixel import OVERLOAD

INPUT_VOLTAGE = 0x01


def test_a_hardware_error_is_told_in_words_with_the_sample_that_has_it() -> None:
    bench = running()
    bench.servo.fail(OVERLOAD)
    bench.tick(2)
    assert bench.drive.phase is HostPhase.FAULT
    assert bench.drive.fault_words() == "hardware error 0x20 (overload)"
    assert bench.drive.drive_state is DriveState.FAULT  # shut down
    assert bench.drive.counters["alerts"] >= 1
    assert bench.drive.setpoint(0) is None


def test_an_error_that_leaves_the_torque_on_is_no_reason_to_go_on_asking() -> None:
    bench = running()
    bench.servo.fail(INPUT_VOLTAGE)  # not in Shutdown (63) by default
    bench.tick(2)
    assert (bench.drive.phase, bench.drive.drive_state) == (HostPhase.FAULT, DriveState.ARMED)
    first = len(bench.sent)
    bench.tick(50)
    assert len(bench.sent) == first
    bench.drive.disable()
    bench.tick(6)
    assert bench.drive.drive_state is DriveState.FAULT
    assert bench.get(64) == 0


def test_a_fault_of_before_is_reset_by_a_reboot_and_the_servo_set_up_anew() -> None:
    bench = Bench()
    bench.servo.fail(OVERLOAD)
    bench.until(HostPhase.FAULT)
    with pytest.raises(ValueError, match="can't be enabled"):
        bench.drive.enable()
    bench.drive.reset_fault()
    bench.until(HostPhase.IDENTIFYING)
    bench.until(HostPhase.READY, 700)
    assert bench.servo.counters["reboots"] == 1
    assert (bench.get(70), bench.get(98), bench.get(68)) == (0, 5, 2)
    bench.drive.enable()
    bench.until(HostPhase.RUNNING)


def test_a_servo_that_restarts_while_running_is_noticed_although_it_answers_as_before() -> None:
    bench = running()
    bench.servo.restart()
    bench.tick(8)  # what it was asked before is lost
    assert bench.drive.phase is HostPhase.DISCONNECTED
    assert bench.drive.counters["restarts"] == 1
    bench.drive.disable()
    bench.tick(6)
    assert bench.drive.drive_state is DriveState.DISABLED


def test_a_watchdog_that_somebody_switched_off_is_a_fault() -> None:
    bench = running()
    bench.servo.table.put(98, 0)
    bench.tick(2)
    assert bench.drive.phase is HostPhase.FAULT
    assert bench.drive.fault_words() == "Bus Watchdog (98) is 0, not 5: another program wrote it"
