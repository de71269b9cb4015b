"""`hil-forceps decode`: frames, bus logs and serial captures as readable signals."""

import csv
import json
import math
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, Protocol, TextIO

from cyclopts import Parameter

from firmware_protocol import scales
from firmware_protocol.codec import Decoder
from firmware_protocol.frames import Frame
from firmware_protocol.messages import Control, DriveState, FaultReason, Message, ParamOp
from hil_forceps.data.readers.bus_logs.account import Account, LoggedFrame, show
from hil_forceps.data.readers.bus_logs.candump import parse_entry
from hil_forceps.data.readers.bus_logs.frames import LOG_SUFFIXES, of_bus, read_frames
from hil_forceps.drives.framing import NATIVE, Framing
from hil_forceps.drives.profile import Decoded
from hil_forceps.drives.registry import PROFILES
from hil_forceps.rig.errors import UserError
from hil_forceps.rig.sections import ProfileName

# A field of a message in SI: its name and the value of one unit.
_IN_SI = {
    "theta_m_ref": ("theta_m_ref_rad", scales.ANGLE_LSB_RAD),
    "theta_m": ("theta_m_rad", scales.ANGLE_LSB_RAD),
    "theta_j": ("theta_j_rad", scales.ANGLE_LSB_RAD),
    "current": ("current_A", scales.CURRENT_LSB_A),
    "tau_w": ("tau_w_N_m", scales.BENCH_TORQUE_LSB_N_M),
    "stamp_us": ("stamp_s", scales.STAMP_LSB_NS * 1e-9),
}
_NAMED = {"state": DriveState, "fault": FaultReason, "op": ParamOp}
_SERIAL_SUFFIXES = {".bin"}
_CHUNK_BYTES = 1 << 16
_MAX_LINE_CHARACTERS = 4096


class Printer(Protocol):
    """Writes one frame in a format."""

    def __call__(self, logged: LoggedFrame, message: Decoded | None, reason: str) -> None:
        """Show one frame; `message` is None when it was refused for `reason`."""


def decode(
    *source: Annotated[str, Parameter(allow_leading_hyphen=True)],
    form: Literal["text", "jsonl", "csv"] = "text",
    drive: ProfileName = "native",
    bus: str | None = None,
    node: int | None = None,
) -> int:
    """Decode frames (`081#1122334455667788`), bus logs (.log .asc .blf .trc) or serial captures (.bin).

    Frames that can't be decoded are shown with the reason, and counted. Exit code 1 if there were any, or no frame at
    all.

    Parameters
    ----------
    source
        Frames in the format of `candump -L`, or files, or - for lines in this format on standard input.
    form
        text: one line for each frame; jsonl: JSON lines; csv: time, bus, id, message, signal, value.
    drive
        Protocol of the drive on the bus.
    bus
        Bus to decode, if a log has several: the interface in candump's format, the channel in others.
    node
        Only show frames of this node.
    """
    if not source:
        raise UserError(
            "decode: no source; give frames such as 081#1122334455667788, a log file, or - for standard input"
        )
    unknown = [each for each in source if each.startswith("-") and each != "-"]
    if unknown:
        raise UserError([f"{each}: unknown option of decode; see hil-forceps decode --help" for each in unknown])
    printer = _PRINTERS[form]()
    read = _native() if drive == "native" else _of_maker(PROFILES[drive].decode)
    has_extended_ids = drive != "native" and PROFILES[drive].has_extended_ids
    refused = total = 0
    torn: Counter[str] = Counter()
    framing = NATIVE if drive == "native" else PROFILES[drive].framing
    damage: list[str] = []
    for logged in _frames(source, bus, torn, damage, framing):
        if logged.frame.is_extended and not has_extended_ids:
            continue  # of another device on the bus
        message, reason = read(logged.frame)
        if node is not None and message is not None and message.values.get("node", node) != node:
            continue
        printer(logged, message, reason)
        total += 1
        refused += message is None
    problems = [*damage] if total or torn else [*damage, f"no frames in {' '.join(source)}"]
    if refused:
        hint = "; if the drive has its maker's protocol, name it with --drive" if drive == "native" else ""
        problems.append(f"{refused} of {total} frames could not be decoded{hint}")
    if torn:
        counts = ", ".join(f"{name} {count}" for name, count in sorted(torn.items()))
        problems.append(f"{torn.total()} packets of the serial capture contain no valid frame: {counts}")
    sys.stderr.write("".join(f"hil-forceps: {problem}\n" for problem in problems))
    return 1 if problems else 0


def _native() -> Callable[[Frame], tuple[Decoded | None, str]]:
    decoder = Decoder()

    def read(frame: Frame) -> tuple[Decoded | None, str]:
        before = dict(decoder.counters)
        message = decoder.decode(frame)
        grown = (name for name, count in decoder.counters.items() if count != before[name])
        reason = next(grown, "not of this protocol")
        return None if message is None else Decoded(type(message).__name__, signals(message)), reason

    return read


def _of_maker(decode_frame: Callable[[Frame], Decoded | None]) -> Callable[[Frame], tuple[Decoded | None, str]]:
    return lambda frame: (decode_frame(frame), "not known here")


def signals(message: Message) -> dict[str, Any]:
    """Return the fields of a message in SI, states, reasons and operations by name; unknown codes as numbers."""
    return dict(_signal(name, value) for name, value in message._asdict().items())


def _signal(name: str, value: int) -> tuple[str, Any]:
    if name in _IN_SI:
        si_name, lsb = _IN_SI[name]
        return si_name, value * lsb
    if name in _NAMED:
        known = {int(member): member.name for member in _NAMED[name]}
        return name, known.get(value, value)
    if name == "control":
        return name, "|".join(bit.name or "" for bit in Control if value & bit) or "NONE"
    return name, value


def _frames(
    sources: Iterable[str], bus: str | None, torn: Counter[str], damage: list[str], framing: Framing
) -> Iterator[LoggedFrame]:
    for source in sources:
        if source == "-":
            yield from of_bus(Path("stdin"), _candump_lines(_stdin_lines(), "stdin"), bus)
        elif "#" in source:
            yield from _candump_lines([source], "argument")
        else:
            yield from _file(Path(source), bus, torn, damage, framing)


def _stdin_lines() -> Iterator[str]:
    stream: TextIO | None = sys.stdin
    if stream is None:
        raise UserError("decode -: standard input is closed; name a file instead")
    return iter(lambda: stream.readline(_MAX_LINE_CHARACTERS), "")


def _candump_lines(lines: Iterable[str], where: str) -> Iterator[LoggedFrame]:
    for number, line in enumerate(lines, 1):
        text = line.strip()
        if not text:
            continue
        entry = parse_entry(text)
        if entry is None:
            raise UserError(f"{where}:{number}: {show(text)} is not a frame; write id#data, as 081#1122334455667788")
        if entry.frame is not None:  # else of another device on the bus, left out as in a log file
            yield LoggedFrame(entry.time_ns, entry.bus, entry.frame)


def _file(
    path: Path, bus: str | None, torn: Counter[str], damage: list[str], framing: Framing
) -> Iterator[LoggedFrame]:
    if not path.is_file():
        raise UserError(
            f"{path}: is a folder; name a file in it" if path.is_dir() else f"{path}: no such file; check the path"
        )
    suffix = path.suffix.lower()
    if suffix in _SERIAL_SUFFIXES:
        yield from _serial_capture(path, torn, framing)
    elif suffix in LOG_SUFFIXES:
        account = Account()
        yield from of_bus(path, read_frames(path, account=account), bus)
        damage += [f"{path}: {told}" for told in account.told()]
    else:
        known = " ".join(sorted(LOG_SUFFIXES | _SERIAL_SUFFIXES))
        raise UserError(f"{path}: unknown log format '{path.suffix}'; known formats: {known}")


def _serial_capture(path: Path, torn: Counter[str], framing: Framing) -> Iterator[LoggedFrame]:
    reader = framing.reader()
    with path.open("rb") as file:
        while chunk := file.read(_CHUNK_BYTES):
            for frame in reader.feed(chunk):
                yield LoggedFrame(None, "", frame)
    torn.update({name: count for name, count in reader.counters.items() if count})


def _label(message: Decoded | None, reason: str) -> str:
    return f"refused: {reason}" if message is None else message.name


def _id_digits(frame: Frame) -> str:
    return f"{frame.arbitration_id:08X}" if frame.is_extended else f"{frame.arbitration_id:03X}"


def _text() -> Printer:
    def show_frame(logged: LoggedFrame, message: Decoded | None, reason: str) -> None:
        time = "" if logged.time_s is None else f"{logged.time_s:.6f} "
        bus = logged.bus and f"{logged.bus} "
        values = {} if message is None else message.values
        shown = " ".join(f"{k}={v:.9g}" if isinstance(v, float) else f"{k}={v}" for k, v in values.items())
        raw = f"{_id_digits(logged.frame)}#{logged.frame.data.hex().upper()}"
        sys.stdout.write(f"{time}{bus}{raw:<21} {_label(message, reason)} {shown}".rstrip() + "\n")

    return show_frame


def _jsonl() -> Printer:
    def show_frame(logged: LoggedFrame, message: Decoded | None, reason: str) -> None:
        row: dict[str, Any] = {"time_s": logged.time_s, "bus": logged.bus or None}
        row["arbitration_id"] = logged.frame.arbitration_id
        row |= {"is_extended": True} if logged.frame.is_extended else {}
        row["data"] = logged.frame.data.hex()
        row |= {"refused": reason} if message is None else {"message": message.name, **_finite(message.values)}
        sys.stdout.write(json.dumps(row, allow_nan=False) + "\n")

    return show_frame


def _finite(values: dict[str, Any]) -> dict[str, Any]:
    """Replace NaN and infinity, which JSON can't express, by None; a maker's drive may send them as 32-bit floats."""
    return {name: None if isinstance(v, float) and not math.isfinite(v) else v for name, v in values.items()}


def _csv() -> Printer:
    writer = csv.writer(sys.stdout, lineterminator="\n")
    writer.writerow(("time_s", "bus", "arbitration_id", "message", "signal", "value"))

    def show_frame(logged: LoggedFrame, message: Decoded | None, reason: str) -> None:
        head = (logged.time_s, logged.bus, f"0x{_id_digits(logged.frame)}", _label(message, reason))
        if message is None:
            writer.writerow((*head, "", logged.frame.data.hex()))
            return
        for name, value in message.values.items():
            writer.writerow((*head, name, value))

    return show_frame


_PRINTERS = {"text": _text, "jsonl": _jsonl, "csv": _csv}
