"""A machine and a simulated servo without a line between: an answer is there at the next tick."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from firmware_protocol.frames import Frame
from firmware_protocol.host.samples import RawSample
from firmware_protocol.states import HostPhase
from hil_forceps.drives.dynamixel.machine import (
    Dynamixel,
    DynamixelConfig,
)
from hil_forceps.rig import Rig, load_rig
from virtual_bus.drives.dynamixel import SimulatedDynamixel
from virtual_bus.plant.load import paper_load

RIG = load_rig(Path(__file__).parents[4] / "configs" / "drives" / "dynamixel.yaml")
NODE, MS = 5, 1_000_000
CONFIG = DynamixelConfig(NODE, 4096.0, 1024.0, 1.0, 5, MS, 3_000_000)
SYNC_WRITE, READ, WRITE, PING = 0x83, 0x02, 0x03, 0x01


class Bench:
    """A machine and a servo in ticks of 1 ms, as the service has them: answers, the reference, what is due."""

    def __init__(self, config: DynamixelConfig = CONFIG, rig: Rig = RIG, **servo: Any) -> None:
        self.drive = Dynamixel(config)
        self.servo = SimulatedDynamixel(rig, paper_load(0), **servo)
        self.now_ns = MS
        self.sent: list[Frame] = []
        self.samples: list[RawSample] = []
        self.to_host: Callable[[Frame], list[Frame]] = lambda frame: [frame]
        self.to_servo: Callable[[Frame], list[Frame]] = lambda frame: [frame]
        self.references = True  # whether the service has any
        self.drive.connect(0)

    def tick(self, count: int = 1, raw: int | None = None) -> None:
        for _ in range(count):
            self.now_ns += MS
            self.servo.wake(self.now_ns)
            for frame in self.servo.take_outbox():
                for each in self.to_host(frame):
                    self.drive.receive(each, self.now_ns)
            fresh = self.drive.take_samples()
            self.samples += fresh
            frames: list[Frame] = []
            if fresh and self.references:
                reference = self.drive.setpoint(fresh[-1].theta_m if raw is None else raw)
                frames += [] if reference is None else [reference]
            frames += self.drive.poll(self.now_ns)
            self.sent += frames
            for frame in frames:
                for each in self.to_servo(frame):
                    self.servo.receive(each, self.now_ns + 1)

    def until(self, phase: HostPhase, most: int = 300) -> None:
        for _ in range(most):
            if self.drive.phase is phase:
                return
            self.tick()
        raise AssertionError(f"{self.drive.phase.name}, not {phase.name}: {self.drive.refusal}")

    def get(self, address: int) -> int:
        return self.servo.table.get(address)


def ready(**more: Any) -> Bench:
    bench = Bench(**more)
    bench.until(HostPhase.READY)
    return bench


def running(**more: Any) -> Bench:
    bench = ready(**more)
    bench.drive.enable()
    bench.until(HostPhase.RUNNING)
    bench.tick(3)
    return bench


def phase(bench: Bench) -> HostPhase:
    return bench.drive.phase


def instructions(frames: list[Frame]) -> list[int]:
    return [frame.data[0] for frame in frames]


def written(frames: list[Frame], address: int) -> list[int]:
    """Values that WRITEs gave an entry."""
    found = [frame.data for frame in frames if frame.data[0] == WRITE and frame.data[1] | frame.data[2] << 8 == address]
    return [int.from_bytes(data[3:], "little") for data in found]
