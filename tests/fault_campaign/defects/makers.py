"""Defects of makers' profiles, and of drives that are not set up as their rig says."""

from typing import Any

import pytest

from firmware_protocol.messages import DriveState
from firmware_protocol.states import HostPhase
from hil_forceps.drives.cia402 import machine as cia402
from hil_forceps.drives.cia402.objects import entries
from hil_forceps.drives.dynamixel.machine import Dynamixel
from hil_forceps.drives.mit.exchange import Exchange
from hil_forceps.drives.mit.machine import Mit
from hil_forceps.drives.moteus import messages as moteus_wire
from hil_forceps.drives.moteus.machine import Moteus
from hil_forceps.drives.odrive import machine as odrive
from hil_forceps.drives.odrive import messages as odrive_wire
from hil_forceps.drives.vesc.machine import Vesc
from hil_forceps.drives.vesc.timeout_trial import Stage, TimeoutTrial
from tests.fault_campaign.defects.table import around, defect
from tests.fault_campaign.schedule import Kind
from virtual_bus.drives.cia402 import SimulatedCia402
from virtual_bus.drives.odrive import SimulatedODrive
from virtual_bus.drives.vesc import SimulatedVesc

CLOSED_LOOP = odrive_wire.AxisState.CLOSED_LOOP_CONTROL


@defect("kick", profiles=("odrive",))
def odrive_closes_the_loop_without_a_reference(patch: pytest.MonkeyPatch) -> None:
    """Closed loop is asked for before the measured angle has gone out: the ODrive goes to its last input."""
    patch.setattr(odrive, "FIRST_REFERENCES", 0)

    def setpoint(old: Any, machine: Any, raw: int) -> Any:
        return None if machine.phase is HostPhase.ENABLING and machine._held_raw is None else old(machine, raw)

    around(patch, odrive.ODrive, "setpoint", setpoint)

    def enable(_: Any, machine: Any, _reference_raw: Any, now_ns: int) -> Any:
        if machine._held_raw is not None:
            return []
        machine._held_raw, machine._closed_asked_ns = 0, now_ns
        node = machine.config.node
        return [odrive_wire.set_position_control(node), odrive_wire.set_axis_state(node, CLOSED_LOOP)]

    around(patch, odrive.ODrive, "_enable", enable)


@defect("burst", "torque", profiles=("odrive",))
def odrive_is_kept_alive(patch: pytest.MonkeyPatch) -> None:
    """Where there is no new reference the last one goes out again, so that the watchdog doesn't trip."""

    def setpoint(old: Any, machine: Any, raw: int) -> Any:
        machine.last = old(machine, raw)
        return machine.last

    def poll(old: Any, machine: Any, now_ns: int) -> Any:
        last, machine.last = getattr(machine, "last", None), None
        frames = old(machine, now_ns)
        if machine.phase is HostPhase.RUNNING:
            kept = machine.__dict__.setdefault("kept", [])
            kept[:] = [last] if last is not None else kept
            if last is None:
                frames = [*kept, *frames]
        return frames

    around(patch, odrive.ODrive, "setpoint", setpoint)
    around(patch, odrive.ODrive, "poll", poll)


@defect("torque", profiles=("odrive",))
def odrive_has_its_watchdog_off(patch: pytest.MonkeyPatch) -> None:
    """The drive isn't set up as the rig says."""

    def loop(old: Any, drive: Any, at_ns: int) -> None:
        drive._watchdog_ns = 0
        old(drive, at_ns)

    around(patch, SimulatedODrive, "_loop", loop)


@defect("torque", profiles=("cia402",), among=(Kind.KILLED, Kind.STOPPED))
def cia402_watches_no_heartbeat(patch: pytest.MonkeyPatch) -> None:
    """1016h isn't written."""
    patch.setattr(cia402, "entries", lambda config: [each for each in entries(config) if each.object_index != 0x1016])


@defect("torque", profiles=("cia402",))
def cia402_heartbeat_is_fed_by_sync(patch: pytest.MonkeyPatch) -> None:
    """The drive counts its time-out by SYNCs that don't come any more."""

    def loop(old: Any, drive: Any, at_ns: int) -> None:
        if drive._host_ns is not None and at_ns - drive._host_ns > 60_000_000:
            drive._host_ns = at_ns
        old(drive, at_ns)

    around(patch, SimulatedCia402, "_loop", loop)


@defect("torque", profiles=("moteus",))
def moteus_gets_a_long_watchdog(patch: pytest.MonkeyPatch) -> None:
    """Each command carries a watchdog of a second."""
    make = moteus_wire.position_command
    patch.setattr(moteus_wire, "position_command", lambda node, command: make(node, command._replace(watchdog_s=1.0)))


@defect("kick", "limits", profiles=("moteus",))
def moteus_is_enabled_at_zero(patch: pytest.MonkeyPatch) -> None:
    """While it is enabled its reference is 0, not the measured angle."""

    def setpoint(old: Any, machine: Any, raw: int) -> Any:
        return old(machine, 0 if machine.phase is HostPhase.ENABLING else raw)

    around(patch, Moteus, "setpoint", setpoint)


@defect("end", profiles=("moteus",))
def moteus_trusts_an_old_answer(patch: pytest.MonkeyPatch) -> None:
    """An answer from before the stop counts as stopped."""

    def disable(old: Any, machine: Any) -> None:
        old(machine)
        machine.drive_state, machine._sample = DriveState.DISABLED, lambda *_: None
        machine._see_mode = lambda *_: None

    around(patch, Moteus, "disable", disable)


@defect("burst", "torque", profiles=("mit",))
def mit_repeats_for_ever(patch: pytest.MonkeyPatch) -> None:
    """A reference whose answer is missing is repeated however old it is."""

    def ask(old: Any, machine: Any, now_ns: int) -> Any:
        machine._reference_ns = max(machine._reference_ns, now_ns - 1)
        return old(machine, now_ns)

    around(patch, Mit, "_ask", ask)


@defect("end", profiles=("mit",), among=(Kind.DELAY,))
def mit_takes_any_answer_for_one_to_exit(patch: pytest.MonkeyPatch) -> None:
    """An answer to a command of before counts as one to "exit"."""
    around(patch, Exchange, "is_to_exit", lambda _old, exchange, _now_ns: exchange._exit_ns is not None)


@defect("end", profiles=("mit",), among=(Kind.DELAY,))
def mit_waits_for_a_flight_only(patch: pytest.MonkeyPatch) -> None:
    """What was held up for longer than a flight is taken for an answer to "exit"."""

    def is_to_exit(old: Any, exchange: Any, now_ns: int) -> bool:
        before, exchange._before_exit = exchange._before_exit, -1
        try:
            return bool(old(exchange, now_ns))
        finally:
            exchange._before_exit = before

    around(patch, Exchange, "is_to_exit", is_to_exit)


@defect("kick", "limits", profiles=("mit",))
def mit_enters_with_zero(patch: pytest.MonkeyPatch) -> None:
    """The first reference with gains is the angle 0."""

    def setpoint(old: Any, machine: Any, raw: int) -> Any:
        return old(machine, 0 if machine.phase is HostPhase.ENABLING else raw)

    around(patch, Mit, "setpoint", setpoint)


@defect("end", profiles=("dynamixel",))
def dynamixel_torque_off_is_not_read_back(patch: pytest.MonkeyPatch) -> None:
    """A servo that was told to take its torque off counts as without torque at once."""

    def off(old: Any, machine: Any) -> Any:
        machine.drive_state = DriveState.DISABLED
        return old(machine)

    around(patch, Dynamixel, "_off", off)


@defect("kick", "limits", profiles=("dynamixel",))
def dynamixel_holds_another_goal(patch: pytest.MonkeyPatch) -> None:
    """The goal while torque is switched on is a tenth of a radian away."""

    def setpoint(old: Any, machine: Any, raw: int) -> Any:
        return old(machine, raw + (1 << 18) if machine.phase is HostPhase.ENABLING else raw)

    around(patch, Dynamixel, "setpoint", setpoint)


@defect("torque", profiles=("vesc",))
def vesc_timeout_is_not_tried(patch: pytest.MonkeyPatch) -> None:
    """A VESC whose timeout is off drives on behind a host that died, and nobody has tried it."""

    def see(old: Any, trial: Any, *answer: Any) -> None:
        old(trial, *answer)
        trial.stage = Stage.PASSED

    def look(_old: Any, drive: Any, _at_ns: int) -> None:
        drive.has_timeout = False

    around(patch, TimeoutTrial, "see", see)
    around(patch, SimulatedVesc, "_look_at_timeout", look)


@defect("kick", "limits", profiles=("vesc",))
def vesc_leads_from_the_first_reference(patch: pytest.MonkeyPatch) -> None:
    """The first reference isn't the measured angle."""

    def setpoint(old: Any, machine: Any, raw: int) -> Any:
        return old(machine, raw - (1 << 18) if machine.phase is HostPhase.ENABLING else raw)

    around(patch, Vesc, "setpoint", setpoint)
