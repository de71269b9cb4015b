"""Fuzzing of the Python side: bytes and frames without sense, millions of them, and what must hold all the time.

Nothing raises, no buffer grows, and the next good frame is always found. `python -m firmware_protocol.conformance.fuzz
10000000` runs a campaign of ten million bytes.
"""

import random
import sys
from collections.abc import Callable
from typing import Final

from firmware_protocol import codec
from firmware_protocol.conformance.fuzz_links import fuzz_host, fuzz_line
from firmware_protocol.conformance.fuzz_source import (
    GOOD,
    MAX_PACKET_BYTES,
    NODE,
    PROBE_EVERY,
    SERIAL_NUMBER,
    Finding,
    Outcome,
    mutated,
    random_frame,
    random_packet,
    require,
)
from firmware_protocol.drive.machine import DriveConfig, DriveMachine
from firmware_protocol.drive.parameter_values import ParameterStore
from firmware_protocol.messages import DriveState, HostHeartbeat, ParamOp, ParamRequest
from firmware_protocol.parameters import BY_INDEX, DICTIONARY, Access, Index
from firmware_protocol.serial_framing import SerialReader, encode_serial

__all__ = ["FUZZERS", "Finding", "Outcome", "campaign", "fuzz_host", "fuzz_line"]

CHUNK_BYTES: Final = 256
PARAM_BYTES: Final = 7  # op, index, value


def fuzz_serial_reader(total_bytes: int, seed: int) -> Outcome:
    """Feed noise, torn and overlong packets; after each zero byte a good packet must come through."""
    chance = random.Random(f"serial {seed}")
    reader = SerialReader()
    fed = probes = got = number = 0
    while fed < total_bytes:
        style = chance.randrange(3)
        if style == 0:
            data = chance.randbytes(chance.randrange(1, CHUNK_BYTES))
        elif style == 1:
            data = bytes((chance.randrange(1, 256),)) * chance.randrange(1, 4 * CHUNK_BYTES)
        else:
            data = b"".join(mutated(chance, random_packet(chance)) for _ in range(8))
        got += len(reader.feed(data))
        fed += len(data)
        number += 1
        require(len(reader._partial) <= MAX_PACKET_BYTES, f"seed {seed}: {len(reader._partial)} bytes kept at {fed}")
        if number % PROBE_EVERY == 0:
            frames = reader.feed(b"\x00" + encode_serial(GOOD))
            require(frames[-1:] == [GOOD], f"seed {seed}: the good packet after {fed} bytes was not found")
            probes += 1
    return Outcome(fed, probes, got)


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
        require(counted == (message is None), f"seed {seed}: {frame} gave {message} and {counted} counts")
        got += message is not None
        fed += len(frame.data) + 2
        if fed % PROBE_EVERY == 0:
            require(decoder.decode(GOOD) is not None, f"seed {seed}: the good frame after {fed} bytes was refused")
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
        require((drive.reference_raw is not None) == running, f"seed {seed}: reference in {drive.state} at {fed}")
        require((drive.fault != 0) == (drive.state is DriveState.FAULT), f"seed {seed}: {drive.fault} at {fed}")
        require(len(answers) <= 5, f"seed {seed}: {len(answers)} frames at once at {fed}")
        got += len(answers)
        fed += len(frame.data) + 2
        if fed % PROBE_EVERY == 0:
            good = codec.encode(ParamRequest(drive.node, ParamOp.READ, Index.NODE, 0))
            require(len(drive.receive(good, now_us, 0)) == 1, f"seed {seed}: no answer to a good request at {fed}")
            probes += 1
    _bring_back(drive, now_us, seed)
    return Outcome(fed, probes, got)


def _bring_back(drive: DriveMachine, now_us: int, seed: int) -> None:
    """Let the host be lost, then reset and enable as a good host does."""
    now_us += 3_000_000
    drive.poll(now_us)
    for sequence, control in enumerate((0, 2, 0, 1)):
        drive.receive(codec.encode(HostHeartbeat(drive.node, control, 1, 0, sequence)), now_us, 0)
    require(drive.state is DriveState.ARMED, f"seed {seed}: {drive.state} after a reset and ENABLE")


def fuzz_parameters(total_bytes: int, seed: int) -> Outcome:
    """Ask for anything in any state; what is held stays within its bounds, what is read-only as it was."""
    chance = random.Random(f"parameters {seed}")
    config = DriveConfig(NODE, SERIAL_NUMBER, bool(seed % 2))
    store, fixed = ParameterStore(config), config.parameter_values()
    interesting = sorted({bound + d for row in DICTIONARY for bound in (row.minimum, row.maximum) for d in (-1, 0, 1)})
    fed = probes = got = 0
    while fed < total_bytes:
        op = chance.choice((ParamOp.READ, ParamOp.WRITE, ParamOp.WRITE, chance.randrange(256)))
        number = chance.choice((chance.choice(DICTIONARY).number, chance.randrange(1 << 16)))
        value = chance.choice((chance.choice(interesting), chance.randrange(-(1 << 31), 1 << 31)))
        result, held = store.execute(op, number, value, chance.random() < 0.7)
        row = BY_INDEX.get(number)
        place = f"seed {seed}: {op}, {number:#06x}, {value} gave {result.name} and {held} at {fed}"
        require((result is ParamOp.UNKNOWN_INDEX) <= (row is None), place)
        if row is not None:
            require(row.minimum <= held <= row.maximum, place)
            require(row.access is not Access.READ_ONLY or held == fixed[number], place)
        require(store[Index.THETA_MIN] <= store[Index.THETA_MAX], place)
        got += result is ParamOp.OK
        fed += PARAM_BYTES
        if chance.random() < 1.0 / PROBE_EVERY:
            answer = store.execute(ParamOp.READ, Index.NODE, value, False)
            require(answer == (ParamOp.OK, NODE), f"seed {seed}: a good READ gave {answer} at {fed}")
            probes += 1
    return Outcome(fed, probes, got)


FUZZERS: Final[tuple[Callable[[int, int], Outcome], ...]] = (
    fuzz_serial_reader,
    fuzz_decoder,
    fuzz_parameters,
    fuzz_drive,
    fuzz_host,
    fuzz_line,
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
