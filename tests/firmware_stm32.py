"""The example image for an STM32F405 under Unicorn, with a model of its bxCAN, timers and converters.

The object code is what a device runs; time is what the caller says. `python -m tests.firmware_stm32` prints the
instructions of each kind of step and the stack used, as docs/porting.md has them.
"""

import importlib
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any, Final

from firmware_protocol import codec
from firmware_protocol.drive.config import DriveConfig
from firmware_protocol.drive.machine import DriveMachine
from firmware_protocol.frames import Frame
from firmware_protocol.messages import DriveState, HostHeartbeat, ParamOp, ParamRequest
from firmware_protocol.parameters import Index
from firmware_protocol.scales import wrap_int32
from tests.bxcan import UNBOUNDED, BxCan
from tests.firmware_library import build_directory, make, optional_tool

FLASH, FLASH_BYTES = 0x0800_0000, 0x10_0000
RAM, RAM_BYTES = 0x2000_0000, 0x2_0000
PERIPHERALS, PERIPHERAL_BYTES = 0x4000_0000, 0x8_0000
RETURN: Final = FLASH + FLASH_BYTES - 0x1000
TIM2_CNT, TIM3_CNT, DAC, ADC, CAN = 0x24, 0x424, 0x7408, 0x1203C, 0x6400
SERIAL: Final = 0x00C0_DE00_0001
RAW_PER_COUNT: Final = (1 << 24) // 16384
_STACK_FILL: Final = 0xA5


def emulator() -> tuple[Any, Any]:
    """Return unicorn and its names for ARM, neither of which has types."""
    return importlib.import_module("unicorn"), importlib.import_module("unicorn.arm_const")


class Stm32:
    """One device, its main loop turned by the caller. `can` is its controller.

    `count` are the instructions of the last call, where `counting`.
    `encoder`, `adc` and `dac` are what its converters hold; a bench overrides `read_encoder`, `read_adc`, `write_dac`.
    """

    def __init__(self, elf: Path, can: BxCan, counting: bool) -> None:
        unicorn, arm = emulator()
        self._arm = arm
        self.can = can
        self.now_us, self.encoder, self.adc, self.dac = 0, 0, 2048, 0
        self.count = 0
        binary = elf.with_suffix(".bin")
        subprocess.run(["arm-none-eabi-objcopy", "-O", "binary", str(elf), str(binary)], check=True)
        listing = subprocess.run(["arm-none-eabi-nm", str(elf)], check=True, capture_output=True, text=True).stdout
        self.symbols = {row.split()[2]: int(row.split()[0], 16) for row in listing.splitlines()}
        uc: Any = unicorn.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS)
        uc.ctl_set_cpu_model(arm.UC_CPU_ARM_CORTEX_M4)
        uc.mem_map(FLASH, FLASH_BYTES)
        uc.mem_write(FLASH, b"\xff" * FLASH_BYTES)
        uc.mem_write(FLASH, binary.read_bytes())
        uc.mem_map(RAM, RAM_BYTES)
        uc.mem_write(self.symbols["_bss_end"], bytes((_STACK_FILL,)) * (RAM + RAM_BYTES - self.symbols["_bss_end"]))
        uc.mmio_map(PERIPHERALS, PERIPHERAL_BYTES, self._read, None, self._write, None)
        if counting:  # ten times slower
            uc.hook_add(unicorn.UC_HOOK_CODE, self._step)
        self._uc = uc
        self._call("setup")

    def turn(self, now_us: int) -> None:
        """Run the main loop once."""
        self.now_us = now_us & 0xFFFF_FFFF
        self._call("turn")

    def stack_bytes(self) -> int:
        """Return how deep the stack has ever been."""
        bottom = self.symbols["_bss_end"]
        memory = bytes(self._uc.mem_read(bottom, RAM + RAM_BYTES - bottom))
        return len(memory.lstrip(bytes((_STACK_FILL,))))

    def read_encoder(self) -> int:
        """Return the encoder's count, of which the timer holds 16 bits."""
        return self.encoder

    def read_adc(self) -> int:
        """Return the conversion of the motor current."""
        return self.adc

    def write_dac(self, value: int) -> None:
        """Take the reference of the current amplifier."""
        self.dac = value

    def _call(self, function: str) -> None:
        self.count = 0
        self._uc.reg_write(self._arm.UC_ARM_REG_SP, RAM + RAM_BYTES)
        self._uc.reg_write(self._arm.UC_ARM_REG_LR, RETURN | 1)
        self._uc.emu_start(self.symbols[function] | 1, RETURN)

    def _step(self, *_: object) -> None:
        self.count += 1

    def _read(self, _uc: Any, offset: int, _size: int, _user: Any) -> int:
        if offset == TIM2_CNT:
            return self.now_us
        if offset == TIM3_CNT:
            return self.read_encoder() & 0xFFFF
        if offset == ADC:
            return self.read_adc()
        return self.can.read(offset - CAN)

    def _write(self, _uc: Any, offset: int, _size: int, value: int, _user: Any) -> None:
        if offset == DAC:
            self.write_dac(value)
        else:
            self.can.write(offset - CAN, value)


@cache
def image() -> Path:
    """Build the example image."""
    optional_tool("arm-none-eabi-gcc")
    make("stm32f4")
    return build_directory() / "arm" / "stm32f4.elf"


def config() -> DriveConfig:
    """Return how the image sets up its drive."""
    return DriveConfig(1, SERIAL, counts_per_rev=16384)


def ideal_device() -> Stm32:
    """Return a device on a bus without delay, with room for any burst."""
    return Stm32(image(), BxCan(UNBOUNDED, instant=True), counting=True)


class Session:
    """The device and a Python drive beside it, given the same; `worst` are instructions by what the step did."""

    def __init__(self) -> None:
        self.device, self.drive = ideal_device(), DriveMachine(config())
        self.worst: dict[str, int] = {}
        self.now_us, self.compared = 0, 0
        self._next_us, self._theta, self._heartbeat, self._setpoint = 0, 0, 0, -1

    def turn(self, what: str, *frames: Frame, wait_us: int = 250, current: int = 0) -> None:
        """Let these frames be there and the main loop turn once; compare what is sent."""
        device, drive = self.device, self.drive
        self.now_us += wait_us
        device.adc = 2048 + current
        wanted = []
        for frame in frames:
            device.can.deliver(frame)
            wanted += drive.receive(frame, self.now_us, self._theta)
        wanted += drive.poll(self.now_us)
        if self.now_us >= self._next_us:
            self._next_us += 1_000
            wanted += drive.poll(self.now_us)
            self._theta = wrap_int32(device.encoder * RAW_PER_COUNT)
            wanted += drive.sample(self.now_us, self._theta, 5 * current)
        device.turn(self.now_us)
        assert device.can.sent == wanted
        device.can.sent.clear()
        self.compared += len(wanted)
        self.worst[what] = max(self.worst.get(what, 0), device.count)

    def heartbeat(self, control: int) -> Frame:
        self._heartbeat += 1
        return codec.encode(HostHeartbeat(1, control, 1, 0, self._heartbeat & 0xFF))

    def setpoint(self, distance: int) -> Frame:
        self._setpoint += 1
        return codec.encode_setpoint(1, self._theta + distance, self._setpoint & 0xFF, self.drive._sequence)

    def run(self, samples: int) -> None:
        """Enable and follow, with everything that a host may ask for in between; then the worst that can come."""
        self.turn("power-up")
        self.turn("heartbeat", self.heartbeat(0))
        self.turn("heartbeat", self.heartbeat(1))
        self.turn("reference", self.setpoint(0))
        ask = codec.encode(ParamRequest(1, ParamOp.READ, Index.SETPOINTS_LOST, 0))
        for i in range(samples):
            self.device.encoder += i % 3
            self.turn("sample, nothing else", wait_us=self._next_us - self.now_us, current=i % 100)
            self.turn("nothing")
            self.turn("reference", self.setpoint(40 * RAW_PER_COUNT))
            if i % 10 == 0:
                self.turn("heartbeat", self.heartbeat(1), wait_us=100)
            if i % 10 == 5:
                self.turn("parameter", ask, wait_us=100)
        assert self.drive.state is DriveState.OPERATIONAL
        assert self.device.dac > 2048
        reference = self.setpoint(40 * RAW_PER_COUNT)
        others = [ask] * 31
        self.turn("32 frames and a sample", reference, *others, wait_us=self._next_us - self.now_us)


def sizes() -> dict[str, int]:
    """Return bytes of flash and RAM, as the linker and the compiler have them."""
    path = image()
    make("arm")
    make("mps2")
    found = {}
    for name, file in (
        ("node", "node.o"),
        ("node and serial line", "node_serial.o"),
        ("example image", path.name),
        ("mps2 image", "mps2.elf"),
    ):
        said = subprocess.run(
            ["arm-none-eabi-size", str(path.parent / file)], check=True, capture_output=True, text=True
        )
        text, data, bss = map(int, said.stdout.splitlines()[1].split()[:3])
        found[f"{name}, flash"] = text + data
        if file == "mps2.elf":
            found[f"{name}, RAM"] = data + bss
    table, binary = path.parent / "sizes.o", path.parent / "sizes.bin"
    subprocess.run(["arm-none-eabi-objcopy", "-O", "binary", "-j", ".rodata", str(table), str(binary)], check=True)
    listing = subprocess.run(["arm-none-eabi-nm", str(table)], check=True, capture_output=True, text=True).stdout
    words = binary.read_bytes()
    for row in listing.splitlines():
        place, _, symbol = row.split()
        value = int.from_bytes(words[int(place, 16) :][:4], "little")
        if symbol in ("hfp_size_of_node", "hfp_size_of_reader"):
            found[symbol.removeprefix("hfp_size_of_") + ", RAM"] = value
    return found


def figures(samples: int = 60) -> dict[str, int]:
    """Return sizes in bytes, instructions by kind of step, and the stack in bytes."""
    session = Session()
    session.run(samples)
    return {**sizes(), "stack, RAM": session.device.stack_bytes(), **session.worst}


if __name__ == "__main__":
    for name, value in figures().items():
        sys.stdout.write(f"{name:30} {value}\n")
