"""Hosts that others wrote, against the simulated drives of DaMiao and CubeMars."""

import struct
import time
from typing import Any

import can
import pytest
from damiao_motor.core.controller import DaMiaoController
from motor_driver import canmotorlib

from hil_forceps.rig import Rig
from tests.unit.drives.mit.simulated import NODE, RIG
from virtual_bus.interface import VirtualForcepsBus


class Paced(VirtualForcepsBus):
    """As fast as a real bus at most: the other program keeps every frame until it gets round to it."""

    def recv(self, timeout: float | None = None) -> can.Message | None:
        time.sleep(2e-4)
        return super().recv(0.001 if timeout == 0 else timeout)


def wide(variant: str, **more: float) -> Rig:
    """A rig with the ranges of kp and kd that the others' programs have fixed."""
    changes = {
        "motor_driver.mit_variant": variant,
        "motor_driver.kp_range_N_m_per_rad": 500.0,
        "motor_driver.kd_range_N_m_s_per_rad": 5.0,
        "motor_driver.watchdog_s": 10.0,
        **{f"motor_driver.{key}": value for key, value in more.items()},
    }
    return RIG.with_changes(changes)


def test_a_host_for_damiaos_commands_the_simulated_one(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = wide("damiao", reply_id=0x15)
    bus = Paced("referee", rig=rig, simulation=0)
    monkeypatch.setattr(can.interface, "Bus", lambda **_: bus)
    controller = DaMiaoController("referee", "virtual_forceps")
    motor = controller.add_motor(
        NODE, 0x15, "4310", p_min=-3.2, p_max=3.2, v_min=-100.0, v_max=100.0, t_min=-0.0135, t_max=0.0135
    )
    controller._stop_polling()  # its thread would move the bus's time beside ours

    def ask(order: Any) -> dict[str, Any]:
        order()
        controller.poll_feedback()
        return dict(motor.get_states())

    try:
        assert ask(motor.disable)["status"] == "DISABLED"
        ask(motor.enable)
        state = ask(motor.send_cmd_mit)
        assert (state["status"], state["can_id"], state["arbitration_id"]) == ("ENABLED", NODE, 0x15)
        target = state["pos"] - 0.2
        for _ in range(300):
            state = ask(lambda: motor.send_cmd_mit(target_position=target, stiffness=0.13, damping=0.0013))
        assert state["pos"] == pytest.approx(target, abs=0.01)
        ask(motor.disable)
        assert ask(motor.disable)["status"] == "DISABLED"
    finally:
        bus.shutdown()


class Socket:
    """What a raw CAN socket does, over the virtual bus."""

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus

    def send(self, packed: bytes) -> None:
        arbitration_id, length, data = struct.unpack("=IB3x8s", packed)
        self._bus.send(can.Message(arbitration_id=arbitration_id, data=data[:length], is_extended_id=False))

    def recvfrom(self, size: int) -> tuple[bytes, None]:
        message = self._bus.recv(0.05)
        assert message is not None
        return struct.pack("=IB3x8s", message.arbitration_id, message.dlc, bytes(message.data).ljust(8))[:size], None


@pytest.mark.parametrize("variant", ["bgkatz", "cubemars"])
def test_a_host_for_cubemars_commands_the_simulated_ones(variant: str, monkeypatch: pytest.MonkeyPatch) -> None:
    bus = VirtualForcepsBus(f"referee-{variant}", rig=wide(variant), simulation=0)
    monkeypatch.setattr(canmotorlib, "set_zero_sleep", 0.0)
    monkeypatch.setattr(canmotorlib.CanMotorController, "can_socket_declared", True)
    monkeypatch.setattr(canmotorlib.CanMotorController, "motor_socket", Socket(bus))
    # The library changes its own table of the motor type; other tests read it as it came.
    monkeypatch.setattr(canmotorlib, "AK80_9_V2_PARAMS", canmotorlib.AK80_9_V2_PARAMS.copy())
    host = canmotorlib.CanMotorController(motor_id=NODE, motor_type="AK80_9_V2")
    host.change_motor_constants(-3.2, 3.2, -100.0, 100.0, 0.0, 500.0, 0.0, 5.0, -0.0135, 0.0135)
    try:
        position, _, _ = host.enable_motor()  # which first sets its zero
        assert position == pytest.approx(0.0, abs=1e-3)
        for _ in range(300):
            position, _, torque = host.send_rad_command(-0.2, 0.0, 0.13, 0.0013, 0.0)
        assert position == pytest.approx(-0.2, abs=0.01)
        assert abs(torque) < 0.002
        host.disable_motor()
        assert host.disable_motor() is not None or variant == "cubemars"  # it asks by a command, outside of motor mode
    finally:
        bus.shutdown()
