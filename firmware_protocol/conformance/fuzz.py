"""Fuzzing of the Python side: bytes and frames without sense, millions of them, and what must hold all the time.

Nothing raises, no buffer grows, and the next good frame is always found. `python -m firmware_protocol.conformance.fuzz
10000000` runs a campaign of ten million bytes.
"""

import random
import sys
from binascii import crc_hqx
from collections.abc import Callable
from typing import Final, NamedTuple

from fastcrc.crc8 import autosar

from firmware_protocol import codec
from firmware_protocol.drive_machine import DriveConfig, DriveMachine
from firmware_protocol.frames import Frame, arbitration_id
from firmware_protocol.host_machine import HostConfig, HostMachine, HostPhase
from firmware_protocol.layouts import LAYOUTS
from firmware_protocol.messages import DriveState, HostHeartbeat, ParamOp, ParamRequest
from firmware_protocol.parameters import Index
from firmware_protocol.samples import MAX_PENDING, MAX_QUEUE
from firmware_protocol.serial_framing import FD_LENGTHS, MAX_FD_PAYLOAD, SerialReader, encode_serial

NODE: Final = 1
SERIAL_NUMBER: Final = 0x5F0C_0000_0001
CHUNK: Final = 256
PROBE_EVERY: Final = 16  # chunks or frames between two good ones
MAX_PACKET: Final = MAX_FD_PAYLOAD + 5
_LENGTHS: Final = sorted(FD_LENGTHS)
_GOOD: Final = codec.encode(ParamRequest(NODE, ParamOp.READ, Index.NODE, 0))


class Finding(AssertionError):  # noqa: N818 - a finding, not an error of the program
    """Something that must always hold did not; the text has the seed and the place."""


class Outcome(NamedTuple):
    """What a campaign did: bytes fed, good frames that had to be found among them, frames that got through."""

    bytes_in: int
    probes: int
    frames: int


def _require(condition: bool, finding: str) -> None:
    if not condition:
        raise Finding(finding)


def _mutated(chance: random.Random, data: bytes) -> bytes:
    """Return the bytes with a few of them changed, left out or repeated."""
    out = bytearray(data)
    for _ in range(chance.randrange(4)):
        at = chance.randrange(len(out)) if out else 0
        kind = chance.randrange(3)
        if kind == 0 and out:
            out[at] ^= 1 << chance.randrange(8)
        elif kind == 1 and out:
            del out[at]
        else:
            out[at:at] = out[at : at + chance.randrange(1, 9)]
    return bytes(out)


def random_frame(chance: random.Random) -> Frame:
    """Return a frame: any id and bytes, or one that is right but for a few bits, or right."""
    style = chance.randrange(4)
    is_fd = chance.random() < 0.3
    if style == 0:
        return Frame(chance.randrange(1 << 11), chance.randbytes(chance.choice(_LENGTHS)), is_fd)
    function = chance.choice(list(LAYOUTS))
    layout = LAYOUTS[function]
    identifier = arbitration_id(function, chance.choice((0, NODE, NODE, NODE, 30)))
    length = chance.choice(_LENGTHS) if layout.length < 0 or style == 1 else layout.length
    if layout.check is layout.check.CRC16 and length >= 2:
        body = chance.randbytes(length - 2)
        crc = crc_hqx(identifier.to_bytes(2, "little") + body, codec.CRC16_INIT)
        frame = Frame(identifier, body + crc.to_bytes(2, "little"), True)
    elif layout.check is layout.check.CRC8 and length >= 1:
        body = chance.randbytes(length - 1)
        frame = Frame(identifier, body + bytes((autosar(identifier.to_bytes(2, "little") + body),)))
    else:
        frame = Frame(identifier, chance.randbytes(length))
    return frame._replace(data=_mutated(chance, frame.data)) if style == 2 else frame


def fuzz_serial_reader(total_bytes: int, seed: int) -> Outcome:
    """Feed noise, torn and overlong packets; after each zero byte a good packet must come through."""
    chance = random.Random(f"serial {seed}")
    reader = SerialReader()
    fed = probes = got = number = 0
    while fed < total_bytes:
        style = chance.randrange(3)
        if style == 0:
            data = chance.randbytes(chance.randrange(1, CHUNK))
        elif style == 1:
            data = bytes((chance.randrange(1, 256),)) * chance.randrange(1, 4 * CHUNK)
        else:
            data = b"".join(_mutated(chance, _packet(chance)) for _ in range(8))
        got += len(reader.feed(data))
        fed += len(data)
        number += 1
        _require(len(reader._partial) <= MAX_PACKET, f"seed {seed}: {len(reader._partial)} bytes kept at {fed}")
        if number % PROBE_EVERY == 0:
            frames = reader.feed(b"\x00" + encode_serial(_GOOD))
            _require(frames[-1:] == [_GOOD], f"seed {seed}: the good packet after {fed} bytes was not found")
            probes += 1
    return Outcome(fed, probes, got)


def _packet(chance: random.Random) -> bytes:
    frame = random_frame(chance)
    fits = len(frame.data) in FD_LENGTHS if frame.is_fd else len(frame.data) <= 8
    return encode_serial(frame if fits else _GOOD)


def fuzz_decoder(total_bytes: int, seed: int) -> Outcome:
    """Decode anything; each frame gives a message or advances one counter."""
    chance = random.Random(f"decoder {seed}")
    decoder = codec.Decoder()
    fed = probes = got = 0
    while fed < total_bytes:
        frame = random_frame(chance)
        before = sum(decoder.counters.values())
        message = decoder.decode(frame)
        counted = sum(decoder.counters.values()) - before
        _require(counted == (message is None), f"seed {seed}: {frame} gave {message} and {counted} counts")
        got += message is not None
        fed += len(frame.data) + 2
        if fed % PROBE_EVERY == 0:
            _require(decoder.decode(_GOOD) is not None, f"seed {seed}: the good frame after {fed} bytes was refused")
            probes += 1
    return Outcome(fed, probes, got)


def fuzz_drive(total_bytes: int, seed: int) -> Outcome:
    """Give a drive anything at any time; it answers, it keeps its invariants, and it can be brought back."""
    chance = random.Random(f"drive {seed}")
    fd = bool(seed % 2)
    drive = DriveMachine(DriveConfig(NODE, SERIAL_NUMBER, fd))
    now_us = chance.randrange(1 << 32)
    fed = probes = got = 0
    while fed < total_bytes:
        frame = random_frame(chance)
        now_us += chance.choice((0, 1, 100, 1000, 1000, 30_000))
        answers = drive.receive(frame, now_us, chance.randrange(-(1 << 40), 1 << 40))
        answers += drive.poll(now_us)
        answers += drive.sample(now_us, chance.randrange(-(1 << 33), 1 << 33), chance.randrange(-(1 << 20), 1 << 20))
        running = drive.state is DriveState.OPERATIONAL
        _require((drive.reference_raw is not None) == running, f"seed {seed}: reference in {drive.state} at {fed}")
        _require((drive.fault != 0) == (drive.state is DriveState.FAULT), f"seed {seed}: {drive.fault} at {fed}")
        _require(len(answers) <= 5, f"seed {seed}: {len(answers)} frames at once at {fed}")
        got += len(answers)
        fed += len(frame.data) + 2
        if fed % PROBE_EVERY == 0:
            good = codec.encode(ParamRequest(drive.node, ParamOp.READ, Index.NODE, 0))
            _require(len(drive.receive(good, now_us, 0)) == 1, f"seed {seed}: no answer to a good request at {fed}")
            probes += 1
    _bring_back(drive, now_us, seed)
    return Outcome(fed, probes, got)


def _bring_back(drive: DriveMachine, now_us: int, seed: int) -> None:
    """Let the host be lost, then reset and enable as a good host does."""
    now_us += 3_000_000
    drive.poll(now_us)
    for sequence, control in enumerate((0, 2, 0, 1)):
        drive.receive(codec.encode(HostHeartbeat(drive.node, control, 1, 0, sequence)), now_us, 0)
    _require(drive.state is DriveState.ARMED, f"seed {seed}: {drive.state} after a reset and ENABLE")


def fuzz_host(total_bytes: int, seed: int) -> Outcome:
    """Give a host anything between the frames of a good drive, in every phase; its queues stay bounded."""
    chance = random.Random(f"host {seed}")
    fd = bool(seed % 2)
    host = HostMachine(HostConfig(node=NODE, fd=fd))
    drive = DriveMachine(DriveConfig(NODE, SERIAL_NUMBER, fd))
    now_ns = fed = probes = got = 0
    while fed < total_bytes:
        if chance.random() < 0.3:
            frame = random_frame(chance)
            host.receive(frame, now_ns)
            fed += len(frame.data) + 2
        now_ns += 300_000_000 if chance.random() < 0.001 else 1_000_000
        got += _good_link(host, drive, now_ns)
        if chance.random() < 0.05:
            _press(chance, host, now_ns)
        if chance.random() < 0.01:
            host.take_samples()
            host.take_bench()
        samples = host._samples
        bounded = len(samples._queue) <= MAX_QUEUE and len(samples._bench) <= MAX_QUEUE
        _require(bounded, f"seed {seed}: queues grow at {fed}")
        pending = max(len(samples._feedback), len(samples._timing))
        _require(pending <= MAX_PENDING, f"seed {seed}: {pending} halves kept at {fed}")
        if chance.random() < 0.001:
            now_ns = _connects(host, drive, now_ns, f"seed {seed}: no connection at {fed}")
            probes += 1
    return Outcome(fed, probes, got)


def _good_link(host: HostMachine, drive: DriveMachine, now_ns: int) -> int:
    """Let a millisecond pass between host and drive; return how many frames the host sent."""
    now_us = now_ns // 1000
    sent = host.poll(now_ns)
    reference = host.setpoint(0)
    for frame in [*sent, reference] if reference is not None else sent:
        for answer in drive.receive(frame, now_us, 0):
            host.receive(answer, now_ns)
    for frame in drive.poll(now_us) + drive.sample(now_us, 0, 0):
        host.receive(frame, now_ns)
    return len(sent)


def _connects(host: HostMachine, drive: DriveMachine, now_ns: int, finding: str) -> int:
    """Leave the host alone with the good drive: it must be connected after a while; return the time then."""
    for _ in range(2000):
        now_ns += 1_000_000
        if host.phase in (HostPhase.DISCONNECTED, HostPhase.REFUSED):
            host.connect(now_ns)
        _good_link(host, drive, now_ns)
        if host.phase in (HostPhase.READY, HostPhase.RUNNING, HostPhase.FAULT):
            return now_ns
    raise Finding(f"{finding}: {host.phase}")


def _press(chance: random.Random, host: HostMachine, now_ns: int) -> None:
    """Do what a user might; a command that does not fit the phase is a ValueError, and only that."""
    actions: tuple[Callable[[], object], ...] = (
        lambda: host.connect(now_ns),
        host.enable,
        host.disable,
        host.reset_fault,
        lambda: host.setpoint(chance.randrange(-(1 << 31), 1 << 31)),
    )
    try:
        chance.choice(actions)()
    except ValueError:
        return


FUZZERS: Final[tuple[Callable[[int, int], Outcome], ...]] = (
    fuzz_serial_reader,
    fuzz_decoder,
    fuzz_drive,
    fuzz_host,
)


def campaign(total_bytes: int, seed: int = 0) -> dict[str, Outcome]:
    """Share so many bytes among all fuzzers; Finding where something does not hold. Same seed, same bytes."""
    share = total_bytes // len(FUZZERS)
    outcomes = {}
    for fuzz in FUZZERS:
        halves = (fuzz(share // 2, 2 * seed), fuzz(share - share // 2, 2 * seed + 1))
        outcomes[fuzz.__name__] = Outcome(*(a + b for a, b in zip(*halves, strict=True)))
    return outcomes


def main(arguments: list[str]) -> int:
    """Run a campaign of so many bytes with this seed."""
    total, seed = (int(text) for text in (*arguments, "0")[:2])
    for name, outcome in campaign(total, seed).items():
        sys.stdout.write(
            f"{name}: {outcome.bytes_in} bytes, {outcome.probes} good ones found, {outcome.frames} frames\n"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
