"""The service and a drive of the project's own protocol on a bus that does as it is told, in virtual time."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from firmware_protocol import codec
from firmware_protocol.drive.machine import DriveConfig, DriveMachine
from firmware_protocol.frames import Frame
from firmware_protocol.host.machine import HostConfig, HostMachine
from firmware_protocol.messages import BenchSensor, DriveState, Setpoint
from firmware_protocol.scales import ANGLE_LSB_RAD
from hil_forceps.bridge.axis import Axis
from hil_forceps.bridge.pipeline import Pipeline
from hil_forceps.bridge.ports import SendResult
from hil_forceps.bridge.results import ServiceConfig, ServiceResult, Telemetry
from hil_forceps.bridge.service import Service
from hil_forceps.control.gate import Gate, GateVerdict
from hil_forceps.data.recording.writer import Recorder
from hil_forceps.estimation.interface import Estimate, Estimator
from hil_forceps.rig.plant import PlantParameters
from hil_forceps.rig.sections import Limits

PLANT = PlantParameters(2.0e-3, 1.4e-3, 3.18e-8, 6.85e-8, 1.16e-4, 4.62e-7, 4.62e-9, 2.6e4, 1.35e-2)
LIMITS = Limits(position_min_rad=-1.0, position_max_rad=3.0, speed_max_rad_per_s=1e4, acceleration_max_rad_per_s2=1e9)
US, MS = 1_000, 1_000_000
NODE = 5
START_RAW = round(1.1 / ANGLE_LSB_RAD)
START_JAW_RAD = START_RAW * ANGLE_LSB_RAD * PLANT.motor_pulley_radius_m / PLANT.jaw_pulley_radius_m
WATCHDOG_MS = 20


class World:
    """Drive, bus and clock in one: time passes when the host sleeps, the motor is wherever it is told to be."""

    def __init__(self, delay_ns: int = 350 * US) -> None:
        self.machine = DriveMachine(DriveConfig(NODE, 77, watchdog_timeout_us=WATCHDOG_MS * 1000))
        self.time_ns = 0
        self.attempts = 0
        self.delay_ns = delay_ns
        self.theta_raw = START_RAW
        self.result = SendResult.SENT  # of the next frames
        self.up = True
        self.mute = False  # the drive is unplugged, the bus is there
        self.late_ns: dict[int, int] = {}  # wake of a sleep until then is so much too late
        self.events: list[tuple[int, Callable[[], None]]] = []
        self.sent: list[tuple[int, Frame]] = []
        self.angles: dict[int, int] = {}  # measured angle by sample sequence, as last sent
        self.counters: dict[str, int] = {}
        self._arrivals: list[tuple[int, Frame]] = []
        self._sample = 0

    def now_ns(self) -> int:
        return self.time_ns

    def sleep_until_ns(self, time_ns: int) -> None:
        target_ns = time_ns + self.late_ns.pop(time_ns, 0)
        while (self._sample * MS) <= target_ns:
            self.time_ns = self._sample * MS
            self._run_drive()
            self._sample += 1
        self.time_ns = max(target_ns, self.time_ns)

    def at(self, time_ns: int, action: Callable[[], None]) -> None:
        self.events.append((time_ns, action))

    def _run_drive(self) -> None:
        for time_ns, action in [event for event in self.events if event[0] <= self.time_ns]:
            self.events.remove((time_ns, action))
            action()
        now_us = self.time_ns // 1000
        frames = self.machine.poll(now_us)
        if self.machine.reference_raw is not None:
            self.theta_raw = self.machine.reference_raw
        self.angles[self._sample % 256] = self.theta_raw
        frames += self.machine.sample(now_us, self.theta_raw, 100)
        frames.append(codec.encode(BenchSensor(NODE, 1000, 2000, self._sample % 256)))
        self._deliver(frames)

    def _deliver(self, frames: list[Frame]) -> None:
        if self.up and not self.mute:
            self._arrivals += [(self.time_ns + self.delay_ns, frame) for frame in frames]

    def send(self, frame: Frame) -> SendResult:
        self.attempts += 1
        if not self.up:
            return SendResult.BUS_DOWN
        if self.result is SendResult.SENT:
            self.sent.append((self.time_ns, frame))
            if not self.mute:
                self._deliver(self.machine.receive(frame, self.time_ns // 1000, self.theta_raw))
        return self.result

    def receive(self) -> list[tuple[int, Frame]]:
        here = [arrival for arrival in self._arrivals if arrival[0] <= self.time_ns]
        self._arrivals = self._arrivals[len(here) :]
        return here

    def is_up(self) -> bool:
        return self.up

    def close(self) -> None:
        self.up = False

    def setpoints(self) -> list[tuple[int, Setpoint]]:
        decoder = codec.Decoder()
        decoded = [(time_ns, decoder.decode(frame)) for time_ns, frame in self.sent]
        return [(time_ns, message) for time_ns, message in decoded if isinstance(message, Setpoint)]


class SpyGate(Gate):
    """Remember what passed."""

    def __init__(self, limits: Limits) -> None:
        super().__init__(limits)
        self.passed: set[int] = set()

    def step(self, requested_rad: float, now_ns: int) -> tuple[float | None, GateVerdict]:
        result = super().step(requested_rad, now_ns)
        if result[0] is not None:
            self.passed.add(round(result[0] / ANGLE_LSB_RAD))
        return result


class Rigged(NamedTuple):
    world: World
    gate: SpyGate
    service: Service
    seen: list[Telemetry]

    def run(self) -> ServiceResult:
        (result,) = self.service.run()
        return result


def estimator(nan_from_ns: int | None = None) -> Estimator:
    def known(state: np.ndarray[tuple[int], np.dtype[np.float64]]) -> Estimate:
        bad = nan_from_ns is not None and state[0] >= nan_from_ns
        return Estimate(float("nan"), float("nan")) if bad else Estimate(1e-3, 1e-6)

    return Estimator("fixed", lambda s: np.array([s.time_ns]), lambda _, s: np.array([s.time_ns]), known)


def rigged(
    world: World | None = None,
    config: ServiceConfig | None = None,
    recorder: Recorder | None = None,
    nan_from_ns: int | None = None,
    stop_at_ns: int | None = None,
    telemetry: Callable[[Telemetry], None] | None = None,
) -> Rigged:
    world = world or World()
    gate = SpyGate(LIMITS)
    line = Pipeline(
        estimator(nan_from_ns),
        lambda t_s: START_JAW_RAD - 0.2 * max(t_s, 0.0),
        PLANT,
        gate,
        True,
        3e-3,
        same_clock=True,
    )
    seen: list[Telemetry] = []
    config = config or ServiceConfig(duration_ns=500 * MS)
    service = Service(
        world,
        world,
        [Axis(HostMachine(HostConfig(NODE)), line, config, recorder)],
        config,
        stop_requested=lambda: stop_at_ns is not None and world.time_ns >= stop_at_ns,
        telemetry=telemetry or seen.append,
    )
    return Rigged(world, gate, service, seen)


def safe(world: World) -> bool:
    return world.machine.state in {DriveState.DISABLED, DriveState.FAULT} and world.machine.reference_raw is None
