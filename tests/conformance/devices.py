"""A drive with a motor that is hardly more than an inertia, and lines to it, in virtual time; made to be broken."""

from collections import deque
from collections.abc import Sequence

from firmware_protocol.conformance.port import MS, Capability
from firmware_protocol.drive.machine import DriveConfig, DriveMachine
from firmware_protocol.frames import Frame
from firmware_protocol.serial_framing import SerialReader, encode_serial

NODE = 5
SERIAL_NUMBER = 0x1A2B_3C4D_5E6F
ANGLE = 1_234_567
LAG = 0.05  # of the way to the reference in one sample
CURRENT_PER_UNIT = 2000 / (1 << 18)


class Device:
    """One drive, sampled each millisecond of its clock, which is that of the line."""

    machine_type: type[DriveMachine] = DriveMachine

    def __init__(self, fd: bool = False, **settings: int) -> None:
        self.machine = self.machine_type(DriveConfig(NODE, SERIAL_NUMBER, fd, **settings))
        self.angle = float(ANGLE)
        self.current = 0
        self.next_ns = MS
        self.reader = SerialReader()

    def receive(self, frame: Frame, now_ns: int) -> list[Frame]:
        """Take a frame; return what the drive answers."""
        return self.machine.receive(frame, now_ns // 1000, round(self.angle))

    def receive_foreign(self, frame: Frame, remote: bool, now_ns: int) -> list[Frame]:  # noqa: ARG002
        """Take a frame with an extended id, or a remote frame."""
        return []

    def receive_bytes(self, data: bytes, now_ns: int) -> list[Frame]:
        """Take bytes from a serial line."""
        return [answer for frame in self.reader.feed(data) for answer in self.receive(frame, now_ns)]

    def receive_datagram(self, data: bytes, now_ns: int) -> list[Frame]:
        """Take a datagram, whose end is the end of a packet."""
        return self.receive_bytes(data + b"\0", now_ns)

    def tick(self, now_ns: int) -> list[Frame]:
        """Poll, sample, move on."""
        self.next_ns = now_ns + MS
        frames = self.poll(now_ns // 1000)
        frames += self.sample(now_ns // 1000)
        self.move()
        return frames

    def poll(self, now_us: int) -> list[Frame]:
        return self.machine.poll(now_us)

    def sample(self, now_us: int) -> list[Frame]:
        return self.machine.sample(now_us, round(self.angle), self.current)

    def goal(self) -> int | None:
        """What the position loop obeys."""
        return self.machine.reference_raw

    def move(self) -> None:
        goal = self.goal()
        if goal is None:
            self.current = 0
            return
        error = goal - self.angle
        self.current = round(error * CURRENT_PER_UNIT)
        self.angle += error * LAG

    def encode(self, frame: Frame) -> bytes:
        """Make a packet for a serial line."""
        return encode_serial(frame)

    def datagrams(self, frame: Frame) -> list[bytes]:
        """Put a frame into datagrams."""
        return [self.encode(frame)]


class DirectPort:
    """A line without delay to one device."""

    virtual_time = True
    capabilities = Capability.FD | Capability.FOREIGN

    def __init__(self, device: Device) -> None:
        self.device = device
        self.time_ns = 0
        self.inbox: deque[tuple[int, Frame]] = deque()

    def send(self, frame: Frame) -> bool:
        self.deliver(self.device.receive(frame, self.time_ns))
        return True

    def send_foreign(self, frame: Frame, remote: bool) -> bool:
        self.deliver(self.device.receive_foreign(frame, remote, self.time_ns))
        return True

    def send_bytes(self, data: bytes) -> bool:
        raise NotImplementedError(data)

    def deliver(self, frames: list[Frame]) -> None:
        for frame in frames:
            self.inbox.append((self.time_ns, frame))

    def receive(self) -> Sequence[tuple[int, Frame]]:
        frames, self.inbox = self.inbox, deque()
        return list(frames)

    def line_errors(self) -> int:
        return 0

    def now_ns(self) -> int:
        return self.time_ns

    def wait_until(self, time_ns: int) -> None:
        device = self.device
        while device.next_ns <= time_ns:
            self.time_ns = device.next_ns
            self.deliver(device.tick(self.time_ns))
        self.time_ns = max(self.time_ns, time_ns)


class DirectSerialPort(DirectPort):
    """A byte stream without delay to one device."""

    capabilities = Capability.FD | Capability.SERIAL | Capability.STREAM

    def __init__(self, device: Device) -> None:
        super().__init__(device)
        self.reader = SerialReader()

    def send(self, frame: Frame) -> bool:
        return self.send_bytes(encode_serial(frame))

    def send_bytes(self, data: bytes) -> bool:
        self.deliver(self.device.receive_bytes(data, self.time_ns))
        return True

    def deliver(self, frames: list[Frame]) -> None:
        for each in frames:
            for frame in self.reader.feed(self.device.encode(each)):
                self.inbox.append((self.time_ns, frame))

    def line_errors(self) -> int:
        return sum(self.reader.counters.values())


class DirectDatagramPort(DirectSerialPort):
    """Datagrams without delay or loss to one device, and back."""

    capabilities = Capability.FD | Capability.SERIAL

    def send_bytes(self, data: bytes) -> bool:
        self.deliver(self.device.receive_datagram(data, self.time_ns))
        return True

    def deliver(self, frames: list[Frame]) -> None:
        for each in frames:
            for datagram in self.device.datagrams(each):
                for frame in self.reader.feed(datagram + b"\0"):
                    self.inbox.append((self.time_ns, frame))
