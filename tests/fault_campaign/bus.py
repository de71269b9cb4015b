"""Faults of the bus: a schedule as the medium's own faults, and nodes that nobody asked for."""

from typing import Final

from firmware_protocol.frames import Frame
from hil_forceps.drives.registry import ids_of
from hil_forceps.rig import Rig
from tests.fault_campaign.drive import FaultyDrive
from tests.fault_campaign.rigs import rig_of
from tests.fault_campaign.schedule import Fault, Kind, Schedule
from virtual_bus.bus import faults as medium
from virtual_bus.bus.bit_timing import BitTiming
from virtual_bus.bus.faults import FOREVER_NS, FaultInjector, FaultKind, Side
from virtual_bus.bus.half_duplex import HalfDuplexLine
from virtual_bus.bus.medium import Medium
from virtual_bus.bus.simulation import Simulation
from virtual_bus.drive import SimulatedDrive
from virtual_bus.drives.registry import SERIAL_LINES, SIMULATED_DRIVES
from virtual_bus.plant.load import paper_load
from virtual_bus.worlds import World

DELAYED: Final = 3  # frames of one fault
_SENDERS: Final = {"to_drive": Side.HOST, "to_host": Side.DRIVE, "both": None}
_LOWEST_PRIORITY: Final = 0x7FE
_NATIVE_STRANGER: Final = 0x01E  # an ESTOP to a node that isn't there
_SERVO_STRANGER: Final = 9


def world_of(schedule: Schedule, references: set[Frame]) -> tuple[World, list[FaultyDrive]]:
    """Build the world of a schedule; the drives come back too, the one that should be there first."""
    rig = rig_of(schedule.profile)
    injector = FaultInjector([each for fault in schedule.faults for each in _on_medium(fault)], schedule.seed)
    stepper = Simulation(_wire(rig, injector))
    starts = [0, *(fault.begin_ns for fault in schedule.of_kind(Kind.SAME_ID))]
    drives = []
    for place, from_ns in enumerate(starts[:2]):
        faults = schedule if not place else schedule._replace(faults=())
        node = FaultyDrive(_drive(rig, schedule.seed + place), faults, references, from_ns)
        stepper.add(node, f"drive{place}", Side.DRIVE).on_bus_off = node.trip
        drives.append(node)
    for fault in schedule.of_kind(Kind.FLOOD):
        stepper.add(_Flood(fault, _stranger(rig, fault)), "flood", Side.DRIVE)
    world = World(
        stepper,
        tuple(node.drive for node in drives),
        rig.bench.transport == "fd" or rig.drive_profile in SERIAL_LINES,
        latency_ns=round(rig.bench.latency_s * 1e9),
        jitter_ns=round(rig.bench.latency_jitter_s * 1e9),
        seed=schedule.seed,
    )
    return world, drives


def _wire(rig: Rig, injector: FaultInjector) -> Medium | HalfDuplexLine:
    if rig.motor_driver is not None and rig.drive_profile in SERIAL_LINES:
        return HalfDuplexLine(SERIAL_LINES[rig.drive_profile], rig.motor_driver.baudrate_bit_per_s, injector)
    return Medium(BitTiming(rig.bench.bitrate_bit_per_s, rig.bench.data_bitrate_bit_per_s), injector)


def _drive(rig: Rig, seed: int) -> object:
    load = paper_load(2)
    if rig.drive_profile == "native":
        return SimulatedDrive(rig, load, seed)
    return SIMULATED_DRIVES[rig.drive_profile](rig, load, seed)


def _on_medium(fault: Fault) -> list[medium.Fault]:
    """Return what the medium itself does to frames or nodes for a fault."""
    kind, sender = fault.kind, _SENDERS.get(fault.where)
    span = (fault.begin_ns, fault.end_ns)
    if kind in {Kind.DROP, Kind.DUPLICATE, Kind.REORDER, Kind.CORRUPT_PAYLOAD, Kind.CORRUPT_WIRE}:
        return [medium.Fault(FaultKind(kind.value), *span, sender=sender, probability=fault.size, bits=3)]
    if kind is Kind.DELAY:
        # Each further frame would wait behind the ones before: a few, or nothing comes any more.
        return [medium.Fault(FaultKind.DELAY, *span, sender=sender, delay_ns=round(fault.size * 1e9), count=DELAYED)]
    if kind is Kind.ERROR_PASSIVE:
        side = Side(fault.where)
        return [medium.Fault(FaultKind.CORRUPT_WIRE, *span, sender=side, count=round(fault.size))]
    if kind is Kind.BUS_OFF:
        return [medium.Fault(FaultKind.BUS_OFF, *span, sender=Side(fault.where))]
    return [medium.Fault(FaultKind.BUS_GONE, *span)] if kind is Kind.BUS_GONE else []


def _stranger(rig: Rig, fault: Fault) -> Frame:
    """Return a frame that belongs to nobody here."""
    if rig.drive_profile in SERIAL_LINES:
        return Frame(_SERVO_STRANGER, b"\x01")
    own = {number for number, is_extended in ids_of(rig) if not is_extended}
    number = _NATIVE_STRANGER if fault.where == "high" else _LOWEST_PRIORITY
    assert number not in own
    return Frame(number, b"\x55" * 8)


class _Flood:
    """Sends one frame over and over while its fault lasts."""

    def __init__(self, fault: Fault, frame: Frame) -> None:
        self._frame = frame
        self._every_ns = round(fault.size * 1e9)
        self._next_ns, self._end_ns = fault.begin_ns, fault.end_ns
        self._outbox: list[Frame] = []

    def receive(self, frame: Frame, now_ns: int) -> None:
        """See `Node`."""

    def next_wake_ns(self) -> int:
        """See `Node`."""
        return self._next_ns if self._next_ns < self._end_ns else FOREVER_NS

    def wake(self, now_ns: int) -> None:
        """See `Node`."""
        while self._next_ns <= now_ns and self._next_ns < self._end_ns:
            self._outbox.append(self._frame)
            self._next_ns += self._every_ns

    def take_outbox(self) -> list[Frame]:
        """See `Node`."""
        frames, self._outbox = self._outbox, []
        return frames
