"""Bus logs as other programs write them, packed here and not by what is tested."""

import struct
import zlib
from collections.abc import Iterable, Sequence

from firmware_protocol import codec
from firmware_protocol.frames import Frame
from firmware_protocol.messages import BenchSensor, DriveState, Feedback, Setpoint, Timing

Timed = tuple[int, Frame]  # ns since 1970
BEGIN_NS = 1_700_000_000_000_000_000
ASC_HEAD = "date Thu May 16 06:16:50.884 pm 2024\nbase hex  timestamps {}\ninternal events logged\n"


def traffic(samples: int, node: int = 1) -> list[Timed]:
    """Return a drive that moves and the host that talks to it, four frames a millisecond."""
    frames = []
    for n in range(samples):
        at = BEGIN_NS + n * 1_000_000
        state = int(DriveState.OPERATIONAL if n > 1 else DriveState.ARMED)
        frames += [
            (at, codec.encode(Feedback(node, 1000 * n, 5 * n, n & 255))),
            (at + 100_000, codec.encode(Timing(node, 1000 * n, n & 255, max(n - 1, 0) & 255, state, 0))),
            (at + 200_000, codec.encode(BenchSensor(node, 7 * n, -11 * n, n & 255))),
            (at + 600_000, codec.encode(Setpoint(node, 1000 * n + 9, n & 255, n & 255))),
        ]
    return frames


def candump(frames: Iterable[Timed], bus: str = "can0") -> list[bytes]:
    """Return the lines of `candump -L`."""
    return [
        f"({t // 10**9:010d}.{t % 10**9 // 1000:06d}) {bus} {f.arbitration_id:03X}#{f.data.hex().upper()}\n".encode()
        for t, f in frames
    ]


def printed(frames: Sequence[Timed], stamps: str) -> list[bytes]:
    """Return the lines of `candump`, without stamps ("") or with those of -t a, d, z or A."""
    lines = []
    last = frames[0][0]
    for t, frame in frames:
        since = t - last if stamps == "d" else t - frames[0][0]
        last = t
        stamp = {
            "": "",
            "a": f"({t // 10**9:010d}.{t % 10**9 // 1000:06d})  ",
            "A": f"(2023-11-14 22:13:{20 + since // 10**9:02d}.{since % 10**9 // 1000:06d})  ",
        }.get(stamps, f"({since // 10**9:03d}.{since % 10**9 // 1000:06d})  ")
        data = " ".join(f"{byte:02X}" for byte in frame.data)
        lines.append(f" {stamp}can0  {frame.arbitration_id:03X}   [{len(frame.data)}]  {data}\n".encode())
    return lines


def asc(frames: Iterable[Timed], stamps: str = "absolute", base: int = 16) -> list[bytes]:
    """Return the lines of an ASC log, with events between the frames that are none."""
    lines = [ASC_HEAD.format(stamps).replace("hex", "hex" if base == 16 else "dec").encode()]
    lines.append(b"Begin Triggerblock Thu May 16 06:16:50.884 pm 2024\n   0.000000 Start of measurement\n")
    last = BEGIN_NS

    def stamp(at: int) -> str:
        nonlocal last
        since, last = (at - (last if stamps == "relative" else BEGIN_NS)), at
        return f"{since // 10**9:4d}.{since % 10**9 // 1000:06d}"

    for number, (t, frame) in enumerate(frames):
        data = " ".join(f"{byte:02X}" if base == 16 else str(byte) for byte in frame.data)
        identifier = f"{frame.arbitration_id:X}" if base == 16 else str(frame.arbitration_id)
        if number % 5 == 4:
            lines.append(f"{stamp(t - 1000)} 1  Statistic: D 0 R 0 XD 0 XR 0 E 0 O 0 B 0.00%\n".encode())
        lines.append(f"{stamp(t)} 1  {identifier:<15} Rx   d {len(frame.data)} {data}\n".encode())
    return [*lines, b"End TriggerBlock\n"]


def trc(frames: Iterable[Timed], version: str = "2.1") -> list[bytes]:
    """Return the lines of a TRC log of one of PEAK's versions."""
    lines = [b"" if version == "1.0" else f";$FILEVERSION={version}\r\n".encode()]
    lines.append({"2.0": b";$COLUMNS=N,O,T,I,d,l,D\r\n", "2.1": b";$COLUMNS=N,O,T,B,I,d,R,L,D\r\n"}.get(version, b""))
    lines.append(b";$STARTTIME=44548.6028595139\r\n; a comment\r\n")
    for number, (t, frame) in enumerate(frames, 1):
        since = t - BEGIN_NS
        offset = f"{since // 10**6}" if version == "1.0" else f"{since // 10**6}.{since % 10**6 // 1000:03d}"
        identifier, count = f"{frame.arbitration_id:04X}", len(frame.data)
        data = " ".join(f"{byte:02X}" for byte in frame.data)
        line = {
            "1.0": f"{number:6d}) {offset:>9}  {identifier}  {count}  {data}",
            "1.1": f"{number:6d}) {offset:>13}  Rx  {identifier}  {count}  {data}",
            "1.2": f"{number:6d}) {offset:>13}  1  Rx  {identifier}  {count}  {data}",
            "1.3": f"{number:6d}) {offset:>13} 1  Rx  {identifier} -  {count}  {data}",
            "2.0": f"{number:7d} {offset:>13} DT {identifier} Rx {count}  {data}",
            "2.1": f"{number:7d} {offset:>13} DT 1 {identifier} Rx -  {count}  {data}",
        }[version]
        lines.append(f"{line}\r\n".encode())
    return lines


def blf_objects(frames: Iterable[Timed], version: int = 1) -> bytes:
    """Return the frames as BLF objects one behind the other, classic ones as CAN_MESSAGE, others as CAN_FD_MESSAGE."""
    objects = []
    for t, frame in frames:
        if frame.is_fd:
            size, tail = len(frame.data), frame.data.ljust(64, b"\0")
            body = struct.pack("<HBBLLBBB5x64s", 1, 0, 15, frame.arbitration_id, 0, 0, 1, size, tail)
        else:
            body = struct.pack("<HBBL8s", 1, 0, len(frame.data), frame.arbitration_id, frame.data)
        stamp = struct.pack("<LHHQ" if version == 1 else "<LBxHQ8x", 2, 0, 0, t - BEGIN_NS)
        size = 16 + len(stamp) + len(body)
        head = struct.pack("<4sHHLL", b"LOBJ", 16 + len(stamp), version, size, 100 if frame.is_fd else 1)
        objects.append(head + stamp + body + bytes(size % 4))
    return b"".join(objects)


def blf(objects: bytes, container_bytes: int, *, packed: bool) -> bytes:
    """Return a BLF file whose containers hold so many bytes of the objects each."""
    head = struct.pack("<4sL", b"LOGG", 144).ljust(144, b"\0")
    containers = []
    for begin in range(0, len(objects), container_bytes):
        piece = objects[begin : begin + container_bytes]
        body = struct.pack("<H6xL4x", 2 if packed else 0, len(piece)) + (zlib.compress(piece) if packed else piece)
        size = 16 + len(body)
        containers.append(struct.pack("<4sHHLL", b"LOBJ", 16, 1, size, 10) + body + bytes(size % 4))
    return head + b"".join(containers)
