"""The reference firmware as a shared library, for the tests: built once, called through ctypes.

HFP_LIBRARY names a library that is built already (with sanitizers, for coverage); else one is built with gcc.
HFP_EXPECT names optional tools (clang g++ arm-none-eabi-gcc) without which tests fail and not only skip.
"""

import atexit
import ctypes
import os
import shutil
import subprocess
import tempfile
from ctypes import POINTER, Structure, c_bool, c_float, c_int16, c_int32, c_int64, c_uint8, c_uint16, c_uint32, c_uint64
from functools import cache
from pathlib import Path
from typing import Any, Final, NoReturn

import cantools
import pytest

from firmware_protocol.drive.config import DriveConfig
from firmware_protocol.drive.machine import COUNTERS
from firmware_protocol.frames import Frame
from firmware_protocol.serial_framing import SERIAL_COUNTERS

SOURCES: Final = Path(__file__).parents[1] / "firmware_protocol" / "c"
DBC: Final[Any] = cantools.database.load_file(SOURCES.parent / "motor_driver.dbc")
VERDICTS: Final = (None, "unknown_id", "bad_length", "bad_format", "bad_crc")
MAX_PACKET: Final = 70
_MASK32: Final = (1 << 32) - 1
_HALF32: Final = 1 << 31


def did_not_run(what: str, expected: bool) -> NoReturn:
    """End a test that needs what is not here: a failure where it is expected, else a skip that says so."""
    text = f"did not run: {what} is not installed"
    if expected:
        pytest.fail(text)
    pytest.skip(text)


def require_tool(name: str) -> str:
    """Return the path of a tool that CI has."""
    path = shutil.which(name)
    if path is None:
        did_not_run(name, "CI" in os.environ)
    return path


def optional_tool(name: str) -> str:
    """Return the path of a tool that not every machine has; HFP_EXPECT names those that this one should."""
    path = shutil.which(name)
    if path is None:
        did_not_run(name, name in os.environ.get("HFP_EXPECT", "").split())
    return path


@cache
def build_directory() -> Path:
    """Make a directory for what is built, gone when the tests are."""
    path = Path(tempfile.mkdtemp(prefix="hfp-"))
    atexit.register(shutil.rmtree, path, ignore_errors=True)
    return path


@cache
def make(target: str, variant: str = "plain") -> Path:
    """Build a target of firmware_protocol/c/Makefile; return the directory of the variant."""
    require_tool("gcc")
    command = [require_tool("make"), "-C", str(SOURCES), f"BUILD={build_directory()}", f"VARIANT={variant}", target]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr
    return build_directory() / variant


class CFrame(Structure):
    _fields_ = (("id", c_uint16), ("is_fd", c_bool), ("length", c_uint8), ("data", c_uint8 * 64))

    def fill(self, frame: Frame) -> None:
        data = frame.data
        self.id, self.is_fd, self.length = frame.arbitration_id, frame.is_fd, len(data)
        ctypes.memmove(self.data, data, len(data))

    def frame(self) -> Frame:
        return Frame(self.id, ctypes.string_at(self.data, self.length), self.is_fd)


class CConfig(Structure):
    _fields_ = (
        ("serial_number", c_uint64),
        ("node", c_uint8),
        ("fd", c_bool),
        *((name, c_int32) for name in DriveConfig.__dataclass_fields__ if name not in ("serial_number", "node", "fd")),
    )


class CDriveHead(Structure):
    """What of hfp_drive is for the caller; the rest is behind it."""

    _fields_ = (
        ("state", c_uint8),
        ("fault", c_uint8),
        ("node", c_uint8),
        ("has_reference", c_bool),
        ("reference_raw", c_int32),
        ("counters", c_uint64 * len(COUNTERS)),
    )


class CReader(Structure):
    _fields_ = (
        ("counters", c_uint64 * len(SERIAL_COUNTERS)),
        ("line", c_uint8),
        ("length", c_uint8),
        ("longest", c_uint8),
        ("packet", c_uint8 * MAX_PACKET),
    )


class CLoopConfig(Structure):
    _fields_ = tuple(
        (name, c_float)
        for name in (
            "sample_time_s",
            "kp_A_per_rad",
            "ki_A_per_rad_s",
            "kd_A_s_per_rad",
            "derivative_cutoff_Hz",
            "current_limit_A",
            "cascade_time_s",
        )
    )


class CReading(Structure):
    _fields_ = (("stamp_us", c_uint32), ("theta_m_raw", c_int32), ("current_raw", c_int32))


PORT_TYPES: Final[tuple[Any, ...]] = (
    ctypes.CFUNCTYPE(c_bool, ctypes.c_void_p, POINTER(CFrame)),
    ctypes.CFUNCTYPE(c_bool, ctypes.c_void_p, POINTER(CFrame)),
    ctypes.CFUNCTYPE(c_uint32, ctypes.c_void_p),
    ctypes.CFUNCTYPE(None, ctypes.c_void_p, POINTER(CReading)),
    ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p),
    ctypes.CFUNCTYPE(None, ctypes.c_void_p, c_float),
    ctypes.CFUNCTYPE(None, ctypes.c_void_p, c_uint8),
)


class CPort(Structure):
    _fields_ = tuple(
        zip(
            ("receive", "send", "now_us", "measure", "protection", "set_current", "keep_node"),
            PORT_TYPES,
            strict=True,
        )
    )


@cache
def library() -> Any:
    """Load the library, with the results of its functions declared; every mirror here has the size of its struct."""
    path = os.environ.get("HFP_LIBRARY")
    loaded = ctypes.CDLL(path or str(make("library") / "libhfp.so"))
    loaded.hfp_crc8.restype = c_uint8
    loaded.hfp_crc8.argtypes = (c_uint16, ctypes.c_char_p, ctypes.c_size_t)
    loaded.hfp_crc16.restype = c_uint16
    loaded.hfp_crc16.argtypes = (c_uint16, ctypes.c_char_p, ctypes.c_size_t)
    loaded.hfp_serial_encode.restype = ctypes.c_size_t
    loaded.hfp_config_default.restype = CConfig
    loaded.hfp_config_default.argtypes = (c_uint8, c_uint64)
    loaded.hfp_drive_rejected.restype = c_uint64
    loaded.hfp_loop_step.restype = c_float
    loaded.hfp_loop_step.argtypes = (ctypes.c_char_p, c_bool, c_int32, c_int32)
    for name in ("serial_init", "serial_feed", "drive_init", "loop_init", "node_init"):
        getattr(loaded, f"hfp_{name}").restype = c_bool
    for name in ("receive", "poll", "sample"):
        getattr(loaded, f"hfp_drive_{name}").restype = c_uint8
    mirrors = {"frame": CFrame, "config": CConfig, "reader": CReader, "loop_config": CLoopConfig, "port": CPort}
    for name, mirror in mirrors.items():
        assert ctypes.sizeof(mirror) == size_of(loaded, name), name
    return loaded


def dirty_memory(name: str) -> Any:
    """Return room for a struct as a stack may leave it: not nought."""
    size = size_of(library(), name)
    return ctypes.create_string_buffer(b"\xa5" * size, size)


def size_of(loaded: Any, name: str) -> int:
    return int(ctypes.c_size_t.in_dll(loaded, f"hfp_size_of_{name}").value)


def c_config(config: DriveConfig) -> CConfig:
    return CConfig(**{name: getattr(config, name) for name in DriveConfig.__dataclass_fields__})


class CDrive:
    """hfp_drive with the calls of `DriveMachine`; angles and times may be unwrapped."""

    def __init__(self, config: DriveConfig) -> None:
        self._lib = library()
        self._bytes = dirty_memory("drive")
        self.head = CDriveHead.from_buffer(self._bytes)
        self._in = CFrame()
        self._out = (CFrame * 2)()
        assert self._lib.hfp_drive_init(self._bytes, ctypes.byref(c_config(config)))

    def receive(self, frame: Frame, now_us: int, theta_m_raw: int) -> list[Frame]:
        self._in.fill(frame)
        now, theta = c_uint32(now_us), c_int32(theta_m_raw)
        return self._sent(self._lib.hfp_drive_receive(self._bytes, ctypes.byref(self._in), now, theta, self._out))

    def poll(self, now_us: int) -> list[Frame]:
        return self._sent(self._lib.hfp_drive_poll(self._bytes, c_uint32(now_us), self._out))

    def sample(self, stamp_us: int, theta_m_raw: int, current_raw: int) -> list[Frame]:
        values = c_uint32(stamp_us), c_int32(theta_m_raw), c_int32(current_raw)
        return self._sent(self._lib.hfp_drive_sample(self._bytes, *values, self._out))

    def trip(self, reason: int) -> None:
        self._lib.hfp_drive_trip(self._bytes, int(reason))

    def rejected(self) -> int:
        return int(self._lib.hfp_drive_rejected(self._bytes))

    def status(self) -> tuple[int, int, int, int | None]:
        """Return node, state, fault and reference as the wire has it."""
        head = self.head
        return head.node, head.state, head.fault, head.reference_raw if head.has_reference else None

    def counters(self) -> dict[str, int]:
        return dict(zip(COUNTERS, self.head.counters, strict=True))

    def _sent(self, count: int) -> list[Frame]:
        return [self._out[i].frame() for i in range(count)]


class CSerialReader:
    """hfp_serial_reader with the calls of `SerialReader`."""

    def __init__(self, max_frame: int = 64) -> None:
        self._lib = library()
        self._reader = CReader.from_buffer(dirty_memory("reader"))
        self._frame = CFrame()
        if not self._lib.hfp_serial_init(ctypes.byref(self._reader), c_uint8(max_frame)):
            raise ValueError(max_frame)

    def feed(self, data: bytes) -> list[Frame]:
        feed, reader, frame = self._lib.hfp_serial_feed, ctypes.byref(self._reader), ctypes.byref(self._frame)
        return [self._frame.frame() for byte in data if feed(reader, byte, frame)]

    @property
    def counters(self) -> dict[str, int]:
        return dict(zip(SERIAL_COUNTERS, self._reader.counters, strict=True))


def c_serial_encode(frame: Frame) -> bytes:
    c_frame, packet = CFrame(), ctypes.create_string_buffer(MAX_PACKET)
    c_frame.fill(frame)
    length = library().hfp_serial_encode(ctypes.byref(c_frame), packet)
    return packet.raw[:length]


_INTEGERS: Final = {
    (8, False): c_uint8,
    (16, False): c_uint16,
    (32, False): c_uint32,
    (64, False): c_uint64,
    (16, True): c_int16,
    (32, True): c_int32,
    (64, True): c_int64,
}


@cache
def generated_struct(message: str) -> type[Structure]:
    """Return the struct that cantools writes for a message of the DBC: a field a signal, rounded up to whole types."""
    signals = DBC.get_message_by_name(message).signals
    size = {signal.name: next(bits for bits in (8, 16, 32, 64) if signal.length <= bits) for signal in signals}
    fields = tuple((s.name, _INTEGERS[size[s.name], s.is_signed]) for s in signals)
    return type(message, (Structure,), {"_fields_": fields or (("dummy", c_uint8),)})
