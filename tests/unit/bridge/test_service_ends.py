"""How a run of the service ends: stop requests, faults, links and drives that go away, full disks, mistakes."""

import errno
import io

import pytest

from firmware_protocol import codec
from firmware_protocol.drive.machine import DriveMachine
from firmware_protocol.frames import split_id
from firmware_protocol.messages import DriveState, FaultReason, Function, Identity
from firmware_protocol.scales import ANGLE_LSB_RAD
from hil_forceps.bridge.ports import SendResult
from hil_forceps.bridge.results import ServiceConfig, Stage, StopReason, Telemetry
from hil_forceps.data.recording.writer import Recorder
from tests.unit.bridge.world import MS, NODE, WATCHDOG_MS, World, rigged, safe


def test_a_stop_request_disables_the_drive_in_whatever_stage_it_comes() -> None:
    for stop_ns in (0, 15 * MS, 60 * MS, 300 * MS):
        bench = rigged(stop_at_ns=stop_ns)
        result = bench.run()
        assert result.reason is StopReason.STOP_REQUESTED
        assert result.ok
        assert bench.world.machine.state is DriveState.DISABLED


def test_a_bus_that_goes_away_ends_the_run_and_the_watchdog_stops_the_motor() -> None:
    world = World()
    bench = rigged(world)
    world.at(200 * MS, world.close)
    result = bench.run()
    assert (result.reason, result.ok, result.drive_disabled) == (StopReason.BUS_DOWN, False, False)
    assert "watchdog" in result.message
    world.sleep_until_ns(world.time_ns + (WATCHDOG_MS + 2) * MS)
    assert safe(world)
    assert world.machine.fault is FaultReason.WATCHDOG


def test_a_fault_of_the_drive_ends_the_run_with_its_reason_in_words() -> None:
    world = World()
    bench = rigged(world)
    world.at(200 * MS, lambda: world.machine.trip(FaultReason.OVERCURRENT))
    result = bench.run()
    assert (result.reason, result.drive_disabled) == (StopReason.DRIVE_FAULT, True)
    assert "OVERCURRENT" in result.message


def test_an_estimate_that_is_not_finite_disables_the_drive_before_its_watchdog() -> None:
    bench = rigged(nan_from_ns=300 * MS)
    result = bench.run()
    assert (result.reason, result.drive_disabled) == (StopReason.REFERENCE_DENIED, True)
    assert bench.world.machine.state is DriveState.DISABLED
    assert max(time_ns for time_ns, _ in bench.world.setpoints()) < 301 * MS


def test_a_drive_that_vanishes_is_noticed() -> None:
    world = World()
    bench = rigged(world)
    world.at(200 * MS, lambda: setattr(world, "mute", True))
    result = bench.run()
    assert (result.reason, result.drive_disabled) == (StopReason.DRIVE_LOST, False)
    assert "did not confirm" in result.message


def test_a_drive_that_was_disabled_by_somebody_else_ends_the_run() -> None:
    world = World()
    bench = rigged(world)

    def restart() -> None:
        world.machine = DriveMachine(world.machine.config)

    world.at(200 * MS, restart)
    result = bench.run()
    assert result.reason in {StopReason.DRIVE_STOPPED, StopReason.DRIVE_LOST}
    assert safe(world)


def test_nobody_there() -> None:
    world = World()
    world.mute = True
    result = rigged(world).run()
    assert (result.reason, result.ok) == (StopReason.NO_DRIVE, False)
    assert "no frame was received" in result.message
    assert world.setpoints() == []


def test_another_version_is_refused_at_connect() -> None:
    world = World()
    world.mute = True
    identity = codec.encode(Identity(NODE, 77, 9, 0))
    world.at(10 * MS, lambda: world._arrivals.append((world.time_ns, identity)))
    result = rigged(world).run()
    assert result.reason is StopReason.VERSION_REFUSED
    assert "9.0" in result.message
    assert {split_id(frame.arbitration_id)[0] for _, frame in world.sent} == {Function.DISCOVER}


def test_a_fault_from_before_ends_the_run_unless_it_may_be_cleared() -> None:
    world = World()
    world.machine.trip(FaultReason.SUPPLY)
    result = rigged(world).run()
    assert result.reason is StopReason.DRIVE_FAULT
    assert "latched fault: SUPPLY" in result.message
    world = World()
    world.machine.trip(FaultReason.SUPPLY)
    result = rigged(world, ServiceConfig(duration_ns=100 * MS, reset_fault=True)).run()
    assert result.reason is StopReason.COMPLETED


def test_a_drive_that_can_not_be_enabled() -> None:
    world = World()
    bench = rigged(world, ServiceConfig(duration_ns=100 * MS, enable_timeout_ns=300 * MS))
    world.at(20 * MS, lambda: setattr(world, "result", SendResult.QUEUE_FULL))
    result = bench.run()
    assert result.reason in {StopReason.ENABLE_FAILED, StopReason.NO_DRIVE}
    assert safe(world)


def test_a_motor_outside_the_limits_is_not_enabled_and_the_message_says_why() -> None:
    world = World()
    world.theta_raw = round(3.5 / ANGLE_LSB_RAD)
    result = rigged(world, ServiceConfig(duration_ns=100 * MS, enable_timeout_ns=300 * MS)).run()
    assert result.reason is StopReason.ENABLE_FAILED
    assert "within `limits:`" in result.message
    assert world.setpoints() == []
    assert safe(world)


class FullDisk(io.BytesIO):
    def write(self, data: object) -> int:
        if self.tell() > 100_000:
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(data)  # type: ignore[arg-type]


@pytest.mark.parametrize("threaded", [False, True])
def test_a_full_disk_under_the_recording_stops_the_run_with_the_drive_disabled(threaded: bool) -> None:
    world = World()
    recorder = Recorder(FullDisk(), {"a": "b"}, threaded)
    result = rigged(world, ServiceConfig(duration_ns=60_000 * MS), recorder).run()
    assert (result.reason, result.drive_disabled) == (StopReason.RECORDING_FAILED, True)
    assert "No space left" in result.message
    assert world.machine.state is DriveState.DISABLED
    recorder.close({})


def test_a_mistake_in_the_program_sends_an_emergency_stop() -> None:
    def broken(telemetry: Telemetry) -> None:
        if telemetry.stage is Stage.RUNNING:
            raise RuntimeError("broken display")

    bench = rigged(telemetry=broken)
    with pytest.raises(RuntimeError, match="broken display"):
        bench.run()
    assert split_id(bench.world.sent[-1][1].arbitration_id)[0] == Function.ESTOP
    assert bench.world.machine.fault is FaultReason.ESTOP
