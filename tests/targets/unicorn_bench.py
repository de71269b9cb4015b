"""The firmware's object code under Unicorn on the virtual bus, an outside plant on its shaft, all in virtual time.

    DeviceNode ── the device: object code, bxCAN, encoder, converters (`tests.firmware_stm32`)
    BenchNode ─── the bench beside it: jaw encoder and load cell, and who tells the controller that a frame has left

The device's instructions take no virtual time. It turns its main loop when a frame arrives, when a mailbox that it
waited for is free, and each 250 µs, which is when its samples fall due.
"""

import math
import shutil
import subprocess
from collections import deque
from functools import cache
from pathlib import Path
from typing import Any, Final

from firmware_protocol import codec
from firmware_protocol.frames import Frame, split_id
from firmware_protocol.messages import DriveState, Function, Timing
from firmware_protocol.scales import ANGLE_LSB_RAD, BENCH_TORQUE_LSB_N_M, CURRENT_LSB_A, wrap_int32
from hil_forceps.rig import Rig
from tests.bxcan import BxCan
from tests.firmware_library import SOURCES
from tests.firmware_stm32 import Stm32, image
from tests.targets.record import TargetRecord
from virtual_bus.drive import PAPER_JAW_START_RAD
from virtual_bus.plant.forceps import NOT_STARTED_NS
from virtual_bus.plant.load import LoadProfile
from virtual_bus.plant.plant import advance, rest_state, truth_parameters

NODE: Final = 1
TURN_NS: Final = 250_000
SAMPLE_NS: Final = 1_000_000
COUNTS_PER_RAD: Final = 16384 / (2.0 * math.pi)
TIM5_CNT, SPI2_DR, SPI3_DR = 0xC24, 0x380C, 0x3C0C
SAMPLE_SEQUENCE_BYTE: Final = 5
MAX_LATCHED: Final = 8
DRIVE_FUNCTIONS: Final = frozenset(
    (Function.FEEDBACK, Function.TIMING, Function.DRIVE_HEARTBEAT, Function.PARAM_RESPONSE, Function.IDENTITY)
)
MID_SCALE, FULL_SCALE, STEPS_PER_A = 2048, 4095, 1000.0


def needs_compiler(record: TargetRecord) -> None:
    """End the test where the image can't be built."""
    if shutil.which("arm-none-eabi-gcc") is None:
        record.not_available("arm-none-eabi-gcc is not installed")


class OutsidePlant:
    """The rig's truth plant under a current that is held between changes; moved when somebody looks."""

    def __init__(self, rig: Rig, load: LoadProfile) -> None:
        self._parameters = truth_parameters(rig.plant(), rig.bench.plant_step_s)
        self._step_s = rig.bench.plant_step_s
        self._load = load
        self._zero_ns = NOT_STARTED_NS
        self._now_ns = 0
        self._state = rest_state(self._parameters, PAPER_JAW_START_RAD)
        self.current_A = 0.0

    def move(self, now_ns: int) -> None:
        """Let time pass under the current and the load."""
        if now_ns > self._now_ns:
            start_ns, end_ns = self._now_ns - self._zero_ns, now_ns - self._zero_ns
            load = self._load
            advance(
                self._state,
                self._parameters,
                self.current_A,
                load.time_ns,
                load.torque_N_m,
                start_ns,
                end_ns,
                self._step_s,
            )
            self._now_ns = now_ns

    def start_load(self, now_ns: int) -> None:
        """Let the load profile begin, once."""
        if self._zero_ns == NOT_STARTED_NS:
            self._zero_ns = now_ns

    def theta_m_rad(self) -> float:
        """Return the angle of the motor pulley."""
        return float(self._state[0])

    def bench_raw(self) -> tuple[int, int]:
        """Return jaw angle and load in units of BENCH_SENSOR."""
        tau_w = self._load.torque_at(self._now_ns - self._zero_ns)
        return round(float(self._state[2]) / ANGLE_LSB_RAD), round(tau_w / BENCH_TORQUE_LSB_N_M)


class BenchStm32(Stm32):
    """The device with its converters on an outside plant; its encoder counts from zero at the jaw's zero."""

    def __init__(self, plant: OutsidePlant, counting: bool) -> None:
        self.plant = plant
        self.now_ns = 0
        self._is_up = False
        super().__init__(image(), BxCan(), counting)
        self._is_up = True

    def turn_at(self, now_ns: int) -> None:
        """Run the main loop once, at this instant of the bus."""
        self.now_ns = now_ns
        self.turn(now_ns // 1000)

    def read_encoder(self) -> int:
        if not self._is_up:  # the counter is cleared at power-up and runs to the angle as it is found
            return 0
        self.plant.move(self.now_ns)
        return math.floor(self.plant.theta_m_rad() * COUNTS_PER_RAD + 0.5)

    def read_adc(self) -> int:
        steps = MID_SCALE + round(self.plant.current_A * STEPS_PER_A)
        return min(max(steps, 0), FULL_SCALE)

    def write_dac(self, value: int) -> None:
        self.plant.move(self.now_ns)
        self.plant.current_A = (value - MID_SCALE) / STEPS_PER_A


class FineStm32(Stm32):
    """The same firmware on a board with converters as fine as the wire (fine_board.c), on an outside plant."""

    def __init__(self, plant: OutsidePlant, counting: bool) -> None:
        self.plant = plant
        self.now_ns = 0
        super().__init__(fine_image(), BxCan(), counting)

    def turn_at(self, now_ns: int) -> None:
        """Run the main loop once, at this instant of the bus."""
        self.now_ns = now_ns
        self.turn(now_ns // 1000)

    def _read(self, uc: Any, offset: int, size: int, user: Any) -> int:
        if offset == TIM5_CNT:
            self.plant.move(self.now_ns)
            return math.floor(self.plant.theta_m_rad() / ANGLE_LSB_RAD + 0.5) & 0xFFFF_FFFF
        if offset == SPI2_DR:
            return round(self.plant.current_A / CURRENT_LSB_A) & 0xFFFF
        return super()._read(uc, offset, size, user)

    def _write(self, uc: Any, offset: int, size: int, value: int, user: Any) -> None:
        if offset == SPI3_DR:
            self.plant.move(self.now_ns)
            self.plant.current_A = wrap_int32(value) * 1e-6
        else:
            super()._write(uc, offset, size, value, user)


@cache
def fine_image() -> Path:
    """Link fine_board.c with the object code of the example image."""
    example = image()
    objects = [*sorted(example.parent.glob("hfp_*.o")), example.parent / "generated" / "motor_driver.o"]
    port, elf = SOURCES / "port" / "stm32f4", example.with_name("fine_board.elf")
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror", "-Os", "-ffunction-sections"]
    flags += ["-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16", "-fdata-sections", "-nostartfiles"]
    sources = (Path(__file__).with_name("fine_board.c"), port / "bxcan.c", port / "startup.c")
    link = ("--specs=nano.specs", "-T", port / "link.ld", "-Wl,--gc-sections")
    subprocess.run(["arm-none-eabi-gcc", *flags, *link, *objects, *sources, "-o", elf], check=True)
    return elf


class DeviceNode:
    """The device as a node of the virtual bus.

    `sample_instructions`: of each turn with a measurement, if counted. `latencies_us`: from each measurement to the
    arrival of the reference that answers it.
    """

    def __init__(self, rig: Rig, load: LoadProfile, fine: bool = False, counting: bool = False) -> None:
        self.plant = OutsidePlant(rig, load)
        self.device = (FineStm32 if fine else BenchStm32)(self.plant, counting)
        self.sample_instructions: list[int] = []
        self.latencies_us: list[float] = []
        self._next_ns = 0

    def receive(self, frame: Frame, now_ns: int) -> None:
        """Take a frame from the bus into the FIFO; the main loop is never long in finding it."""
        if self._next_ns < now_ns:
            self.wake(now_ns)
        if split_id(frame.arbitration_id)[0] == Function.SETPOINT and len(frame.data) > SAMPLE_SEQUENCE_BYTE:
            newest = now_ns // SAMPLE_NS
            age = (newest - frame.data[SAMPLE_SEQUENCE_BYTE]) & 0xFF
            self.latencies_us.append((now_ns - (newest - age) * SAMPLE_NS) / 1e3)
        self.device.can.deliver(frame)
        self.device.turn_at(now_ns)

    def receive_foreign(self, frame: Frame, remote: bool, now_ns: int) -> None:
        """Take a frame with an extended id, or a remote frame."""
        self.device.can.deliver(frame, extended=not remote, remote=remote)
        self.device.turn_at(now_ns)

    def transmitted(self, now_ns: int) -> None:
        """Hear from the bus that a frame of the device has left."""
        if self.device.can.transmitted():
            self.device.turn_at(now_ns)

    def next_wake_ns(self) -> int:
        """Return when the main loop is turned next."""
        return self._next_ns

    def wake(self, now_ns: int) -> None:
        """Turn the main loop at each of its times up to now."""
        while self._next_ns <= now_ns:
            at_ns = self._next_ns
            self._next_ns += TURN_NS
            self.device.turn_at(at_ns)
            if at_ns % SAMPLE_NS == 0:
                self.sample_instructions.append(self.device.count)

    def take_outbox(self) -> list[Frame]:
        """Offer the oldest frame of the mailboxes for arbitration."""
        frame = self.device.can.offer()
        return [] if frame is None else [frame]


class BenchNode:
    """Jaw encoder and load cell, latched with the device's measurements, sent when TIMING has told which one it was.

    The load begins with the first measurement that says OPERATIONAL.
    """

    def __init__(self, device: DeviceNode) -> None:
        self._device = device
        self._decoder = codec.Decoder()
        self._latched: deque[tuple[int, tuple[int, int]]] = deque(maxlen=MAX_LATCHED)
        self._next_ns = 0
        self._outbox: list[Frame] = []

    def receive(self, frame: Frame, now_ns: int) -> None:
        """Hear what is on the bus; what a drive sends is the device's."""
        if split_id(frame.arbitration_id)[0] not in DRIVE_FUNCTIONS:
            return
        self._device.transmitted(now_ns)
        message = self._decoder.decode(frame)
        if isinstance(message, Timing):
            self._on_timing(message)

    def next_wake_ns(self) -> int:
        """Return when the next measurement is due."""
        return self._next_ns

    def wake(self, now_ns: int) -> None:
        """Latch both sensors."""
        self._next_ns = now_ns + SAMPLE_NS
        self._device.plant.move(now_ns)
        self._latched.append((now_ns // 1000, self._device.plant.bench_raw()))

    def take_outbox(self) -> list[Frame]:
        """Hand over what is to be sent."""
        frames, self._outbox = self._outbox, []
        return frames

    def _on_timing(self, timing: Timing) -> None:
        if timing.state == DriveState.OPERATIONAL:
            self._device.plant.start_load(timing.stamp_us * 1000)
        raw = dict(self._latched).get(timing.stamp_us)
        if raw is not None:
            self._outbox.append(codec.encode_bench_sensor(timing.node, *raw, timing.sequence))
