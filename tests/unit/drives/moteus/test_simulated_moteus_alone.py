"""The simulated moteus by itself, and the maker's own controller against it."""

import asyncio
import math
from typing import Any

import can
import moteus as maker
import pytest
from hypothesis import given
from hypothesis import strategies as st
from moteus import transport_device

from firmware_protocol.frames import Frame
from hil_forceps.drives.moteus import messages as wire
from hil_forceps.drives.moteus.messages import Command
from hil_forceps.rig import load_rig
from hil_forceps.rig.errors import UserError
from tests.unit.drives.moteus.simulated import MS, NODE, RIG, RIG_FILE, peer
from virtual_bus.drives.moteus import POSITION, STOPPED, TIMEOUT, SimulatedMoteus
from virtual_bus.drives.odrive import SimulatedODrive
from virtual_bus.interface import VirtualForcepsBus
from virtual_bus.plant.load import paper_load


def position(position_rev: float, command: Command | None = None) -> Frame:
    arbitration_id, head, tail = wire.position_command(NODE, command or Command(1.0, 0.1))
    return Frame(arbitration_id, head + wire.pack_position(position_rev) + tail, True, True)


def enabled(drive: SimulatedMoteus) -> int:
    """Bring it into position mode where it is; return the next ms."""
    drive.receive(position(drive.position_rev()), MS)
    drive.wake(20 * MS)
    assert drive.mode == POSITION
    return 21


def test_only_commands_feed_the_watchdog_and_its_timeout_is_latched() -> None:
    drive = peer()
    ms = enabled(drive)
    for n in range(20):
        drive.receive(position(drive.position_rev()), (ms + 50 * n) * MS)
    assert drive.mode == POSITION
    ms += 1000
    for n in range(200):
        drive.receive(wire.query(NODE), (ms + n) * MS)
    assert drive.mode == TIMEOUT
    for n in range(200, 300):
        drive.receive(position(drive.position_rev()), (ms + n) * MS)
    assert drive.mode == TIMEOUT
    drive.receive(wire.stop(NODE), (ms + 300) * MS)
    drive.wake((ms + 301) * MS)
    assert drive.mode == STOPPED


def moved_rad(write_limits: bool) -> float:
    """How far a step of a quarter turn gets in 30 ms."""
    drive = peer()
    ms = enabled(drive)
    start_rad = float(drive._forceps.truth(drive.next_wake_ns()).theta_m_rad)
    target = drive.position_rev() - 0.1
    frame = position(target)
    if not write_limits:
        limits = bytes.fromhex("0f27cdcccc3d000080bf000080bf")
        without = frame.data.replace(limits, bytes.fromhex("0d27cdcccc3d") + b"\x50" * 8)
        assert without != frame.data
        frame = frame._replace(data=without)
    for n in range(30):
        drive.receive(frame, (ms + n) * MS)
    return abs(float(drive._forceps.truth(drive.next_wake_ns()).theta_m_rad) - start_rad)


def test_unless_told_otherwise_it_leads_its_reference_at_its_own_acceleration() -> None:
    """50 rev/s² for 30 ms are 0.0225 turns of the tenth that is asked for."""
    assert moved_rad(write_limits=True) > 3.0 * moved_rad(write_limits=False) > 0.0


def test_it_shows_the_mode_of_before_the_command_and_answers_only_where_asked() -> None:
    drive = peer()
    drive.receive(position(drive.position_rev()), MS)
    (frame,) = drive.take_outbox()
    feedback = wire.parse_feedback(frame.data)
    assert feedback is not None
    assert (feedback.mode, frame.arbitration_id, frame.is_extended, frame.is_fd) == (STOPPED, 0x500, False, True)
    asks_not = wire.query(NODE)._replace(arbitration_id=NODE, is_extended=False)
    drive.receive(asks_not, 2 * MS)
    drive.receive(wire.query(NODE + 1), 2 * MS)
    drive.receive(wire.query(NODE)._replace(arbitration_id=0x1_8005), 2 * MS)  # another prefix
    assert drive.take_outbox() == []


def test_a_torque_limit_is_told_under_a_code_that_is_no_fault() -> None:
    drive = peer()
    ms = enabled(drive)
    drive.receive(position(drive.position_rev() + 0.05, Command(1e-6, 0.1)), ms * MS)
    drive.wake((ms + 2) * MS)
    assert (drive.mode, drive.fault) == (POSITION, 102)


def test_a_register_that_it_has_not_ends_its_answer() -> None:
    drive = peer()
    drive.receive(Frame(0x8005, bytes.fromhex("1100 1a8302 110f 50"), True, True), MS)
    (frame,) = drive.take_outbox()
    assert frame.data == bytes.fromhex("210000 31830201")
    assert wire.refused_register(frame.data) == 0x103


BYTES = st.binary(max_size=64)


@given(st.lists(st.tuples(st.sampled_from([0x8005, 0x5, 0x807F, 0x1234]), BYTES, st.integers(0, 3 * MS)), max_size=20))
def test_whatever_comes_the_peer_goes_on(frames: list[tuple[int, bytes, int]]) -> None:
    drive = peer()
    now_ns = MS
    for arbitration_id, data, step_ns in frames:
        now_ns += step_ns
        drive.receive(Frame(arbitration_id, data, True, arbitration_id > 0x7FF), now_ns)
    drive.wake(now_ns + 50 * MS)
    drive.receive(wire.query(NODE), now_ns + 60 * MS)
    assert wire.parse_feedback(drive.take_outbox()[-1].data) is not None


def test_a_rig_of_another_drive_is_refused() -> None:
    with pytest.raises(UserError, match="must be moteus here"):
        SimulatedMoteus(load_rig(RIG_FILE.with_name("odrive.yaml")), paper_load(0))
    with pytest.raises(UserError, match="must be odrive here"):
        SimulatedODrive(RIG, paper_load(0))


# -- the maker's own library against the peer -------------------------------------------------------------------------


class VirtualTimeDevice(transport_device.TransportDevice):  # type: ignore[misc]
    """The maker's transport on the virtual bus: a request costs a millisecond of the bus's time."""

    def __init__(self, bus: VirtualForcepsBus) -> None:
        super().__init__()
        self.bus = bus
        self.heard: list[can.Message] = []

    def empty_bus_tx_safe(self) -> bool:
        return True

    async def send_frame(self, frame: Any) -> None:
        data = frame.data.ljust(self._round_up_dlc(len(frame.data)), b"\x50")
        self.bus.send(
            can.Message(
                arbitration_id=frame.arbitration_id,
                is_extended_id=frame.is_extended_id,
                is_fd=frame.is_fd,
                bitrate_switch=frame.bitrate_switch,
                data=data,
            )
        )

    async def transaction(self, requests: list[Any], **_: Any) -> None:
        for request in requests:
            await self.send_frame(request.frame)
            end_ns = self.bus.now_ns() + MS
            while (message := self.bus.recv(max(0.0, (end_ns - self.bus.now_ns()) * 1e-9))) is not None:
                self.heard.append(message)
                frame = transport_device.Frame(
                    message.arbitration_id,
                    bytes(message.data),
                    message.dlc,
                    message.is_extended_id,
                    message.is_fd,
                    message.bitrate_switch,
                )
                if request.frame_filter is not None and request.frame_filter(frame):
                    request.responses.append(frame)


@pytest.mark.parametrize("node", [5, 8])
def test_the_makers_controller_drives_the_simulated_moteus(node: int) -> None:
    rig = RIG.with_changes({"motor_driver.node_id": node, "bench.latency_s": 0.0, "bench.latency_jitter_s": 0.0})

    async def session() -> None:
        with VirtualForcepsBus(f"maker {node}", rig=rig, simulation=0) as bus:
            device = VirtualTimeDevice(bus)
            query = maker.QueryResolution()
            query.q_current = maker.F32
            controller = maker.Controller(id=node, query_resolution=query, transport=maker.Transport([device]))
            register = maker.Register
            first = await controller.query()
            assert first.id == node
            assert first.values[register.MODE] == maker.Mode.STOPPED
            assert set(first.values) == {0, 1, 2, 3, 4, 0xD, 0xE, 0xF}
            at = first.values[register.POSITION]
            for _ in range(20):
                result = await controller.set_position(position=at, velocity_limit=-1.0, accel_limit=-1.0, query=True)
            assert result.values[register.MODE] == maker.Mode.POSITION
            for _ in range(100):
                result = await controller.set_position(
                    position=at + 0.003, velocity_limit=-1.0, accel_limit=-1.0, query=True
                )
            assert result.values[register.POSITION] == pytest.approx(at + 0.003, abs=5e-4)
            assert result.values[register.FAULT] == 0
            assert abs(result.values[register.Q_CURRENT]) < rig.require_drive().current_limit_A
            for _ in range(120):
                result = await controller.query()
            assert result.values[register.MODE] == maker.Mode.TIMEOUT
            result = await controller.set_position(position=at, query=True)
            assert result.values[register.MODE] == maker.Mode.TIMEOUT
            await controller.set_stop(query=True)
            result = await controller.query()
            assert result.values[register.MODE] == maker.Mode.STOPPED
            assert {message.is_extended_id for message in device.heard} == {node >= 8}
            assert all(message.is_fd and message.bitrate_switch for message in device.heard)

    asyncio.run(session())


def test_the_makers_integer_registers_are_understood() -> None:
    async def session() -> None:
        with VirtualForcepsBus("integers", rig=RIG, simulation=0) as bus:
            query = maker.QueryResolution()
            for name in ("position", "velocity", "torque", "q_current"):
                setattr(query, name, maker.INT16)
            resolution = maker.PositionResolution()
            resolution.position = maker.INT32
            controller = maker.Controller(
                id=NODE,
                query_resolution=query,
                position_resolution=resolution,
                transport=maker.Transport([VirtualTimeDevice(bus)]),
            )
            at = (await controller.query()).values[maker.Register.POSITION]
            for _ in range(30):
                await controller.set_position(position=at, query=True)
            result = await controller.set_position(position=math.nan, query=True)  # stay where it is
            assert result.values[maker.Register.POSITION] == pytest.approx(at, abs=5e-4)
            assert result.values[maker.Register.MODE] == maker.Mode.POSITION

    asyncio.run(session())
