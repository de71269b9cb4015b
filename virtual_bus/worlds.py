"""Whole worlds in virtual time, and which channel name leads to which."""

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from hil_forceps.rig import Rig, load_rig
from virtual_bus.bus.bit_timing import NS_PER_S, BitTiming
from virtual_bus.bus.faults import Fault, FaultInjector, Side
from virtual_bus.bus.half_duplex import HalfDuplexLine
from virtual_bus.bus.host_node import HostNode
from virtual_bus.bus.medium import Medium
from virtual_bus.bus.node import Node
from virtual_bus.bus.port import DEFAULT_QUEUE_FRAMES, Port
from virtual_bus.bus.simulation import Simulation
from virtual_bus.bus.wire import LineCodec
from virtual_bus.drive import SimulatedDrive
from virtual_bus.drives.registry import SERIAL_LINES, SIMULATED_DRIVES, SimulatedMotorDriver
from virtual_bus.plant.load import LoadProfile


@dataclass(slots=True)
class World:
    """A bus with what hangs on it besides hosts; `lock` is for hosts in several threads.

    `is_fd`: frames may have more than eight bytes, as on a serial line.
    """

    simulation: Simulation
    drives: tuple[SimulatedMotorDriver, ...]
    is_fd: bool
    latency_ns: int = 0
    jitter_ns: int = 0
    seed: int = 0
    lock: threading.Lock = field(default_factory=threading.Lock)
    hosts: int = 0  # ever attached

    def add_host(self, queue_frames: int, receive_frames: int) -> tuple[HostNode, Port]:
        """Attach one more host."""
        self.hosts += 1
        node = HostNode(self.latency_ns, self.jitter_ns, f"{self.seed} {self.hosts}", receive_frames)
        return node, self.simulation.add(node, f"host{self.hosts}", Side.HOST, queue_frames, answers=False)


def as_rigs(rigs: Rig | str | Path | Sequence[Rig | Path]) -> tuple[Rig, ...]:
    """Return rigs, read where paths are given, in a text separated by commas; UserError when that fails."""
    if isinstance(rigs, str):
        return tuple(load_rig(each) for each in rigs.split(","))
    if isinstance(rigs, Rig | Path):
        rigs = (rigs,)
    return tuple(each if isinstance(each, Rig) else load_rig(each) for each in rigs)


def drive_world(
    rigs: Sequence[Rig],
    load: LoadProfile,
    seed: int,
    is_fd: bool,
    faults: Sequence[Fault],
    timing: BitTiming,
    truth_s: float,
) -> World:
    """Build the world of rigs: their drives on one line, of the first's kind. UserError when one doesn't say enough.

    `truth_s` seconds of truth are logged. Latency and jitter of hosts are the first rig's.
    """
    injector = FaultInjector(faults, seed) if faults else None
    codec = SERIAL_LINES.get(rigs[0].drive_profile)
    stepper = Simulation(Medium(timing, injector) if codec is None else _line(rigs[0], codec, injector))
    drives: list[SimulatedMotorDriver] = []
    for place, rig in enumerate(rigs):
        drive: SimulatedMotorDriver
        if rig.drive_profile == "native":
            drive = SimulatedDrive(rig, load, seed + place, fd=is_fd, truth_duration_s=truth_s)
        else:
            drive = SIMULATED_DRIVES[rig.drive_profile](rig, load, seed + place, truth_s)
        stepper.add(drive, f"drive{place}" if place else "drive", Side.DRIVE).on_bus_off = drive.trip
        drives.append(drive)
    first = rigs[0].bench
    return World(
        stepper,
        tuple(drives),
        is_fd or codec is not None,
        latency_ns=round(first.latency_s * NS_PER_S),
        jitter_ns=round(first.latency_jitter_s * NS_PER_S),
        seed=seed,
    )


def _line(rig: Rig, codec: LineCodec, faults: FaultInjector | None) -> HalfDuplexLine:
    assert rig.motor_driver is not None
    return HalfDuplexLine(codec, rig.motor_driver.baudrate_bit_per_s, faults)


def node_world(nodes: Sequence[Node], seed: int, is_fd: bool, faults: Sequence[Fault], timing: BitTiming) -> World:
    """Build a world of any nodes."""
    stepper = Simulation(Medium(timing, FaultInjector(faults, seed) if faults else None))
    for index, node in enumerate(nodes):
        stepper.add(node, f"node{index}", Side.DRIVE, DEFAULT_QUEUE_FRAMES)
    return World(stepper, (), is_fd, seed=seed)


class _Entry:
    """A world with the number of handles on it and what it was made of."""

    def __init__(self, world: World, recipe: object) -> None:
        self.world = world
        self.recipe = recipe
        self.handles = 1


_channels: dict[str, _Entry] = {}
_channels_lock = threading.Lock()


def join(channel: str, recipe: object, make: Callable[[], World] | None) -> World:
    """Return the world of a channel, made when it has none yet; leave it by `leave`.

    ValueError when a world would have to be made and there is no `make`, or when there is one made otherwise.
    """
    with _channels_lock:
        entry = _channels.get(channel)
        if entry is None:
            if make is None:
                raise ValueError(f"nothing is on channel {channel!r} yet; say what is there by the option rig=RIG.yaml")
            entry = _channels[channel] = _Entry(make(), recipe)
            return entry.world
        if make is not None and entry.recipe != recipe:
            raise ValueError(f"channel {channel!r} already has a world made of something else; leave out rig and nodes")
        entry.handles += 1
        return entry.world


def leave(channel: str) -> None:
    """Give back one handle; the world ends with the last."""
    with _channels_lock:
        entry = _channels[channel]
        entry.handles -= 1
        if entry.handles == 0:
            del _channels[channel]


def channels() -> list[str]:
    """Return the names of the channels that lead somewhere."""
    with _channels_lock:
        return sorted(_channels)
