"""docs/protocol.md says what the code does: tables, example and arithmetic are read from it and computed anew."""

import re
from pathlib import Path

import pytest

from firmware_protocol import codec
from firmware_protocol.frames import Frame
from firmware_protocol.layouts import LAYOUTS, Check
from firmware_protocol.messages import (
    PROTOCOL_MAJOR,
    PROTOCOL_MINOR,
    Control,
    DriveState,
    FaultReason,
    Function,
    ParamOp,
)
from firmware_protocol.parameters import DICTIONARY
from firmware_protocol.serial_framing import SerialReader, encode_serial

ROOT = Path(__file__).parents[3]
SPEC = (ROOT / "docs" / "protocol.md").read_text(encoding="utf-8")
REQUIREMENT = re.compile(r"^- \*\*HFP-(\d{3})\*\* (.+?)(?=\n- |\n\n)", re.MULTILINE | re.DOTALL)

# What no test of software can see: bit timing, oscillators, power cycles, amplifiers.
NOT_HERE = {1, 3, 52, 56, 67, 123, 172}


def section(title: str) -> list[list[str]]:
    """Return the cells of the table rows under a heading."""
    text = re.split(rf"^#+ {re.escape(title)}$", SPEC, flags=re.MULTILINE)[1]
    text = re.split(r"^#+ ", text, flags=re.MULTILINE)[0]
    rows = [line for line in text.splitlines() if line.startswith("|") and not line.startswith("|---")]
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]


def test_requirements_are_numbered_once_in_order_and_demand_one_thing() -> None:
    found = REQUIREMENT.findall(SPEC)
    numbers = [int(number) for number, _ in found]
    assert numbers == sorted(set(numbers))
    assert len(numbers) == SPEC.count("- **HFP-") > 90
    for number, text in found:
        assert re.search(r"\b(MUST|SHOULD|MAY)\b|is new when", text), number
        assert text.endswith("."), number


def test_each_requirement_has_a_test_that_names_it() -> None:
    files = (*ROOT.glob("tests/unit/firmware_protocol/**/test_*.py"), *ROOT.glob("tests/*/test_protocol_*.py"))
    text = "".join(path.read_text(encoding="utf-8") for path in sorted(files))
    named = {int(number) for number in re.findall(r"HFP-(\d{3})", text)}
    for name in re.findall(r"def test_(\w*hfp_\w+)", text):
        named |= {int(number) for number in re.findall(r"(?<![0-9])(\d{3})(?![0-9])", name)}
    required = {int(number) for number, _ in REQUIREMENT.findall(SPEC)}
    assert required - named == NOT_HERE
    assert named <= required


def test_version() -> None:
    assert SPEC.startswith(f"# Motor driver protocol, version {PROTOCOL_MAJOR}.{PROTOCOL_MINOR}\n")


def test_message_table() -> None:
    names = {Check.NONE: "none", Check.CRC8: "CRC-8", Check.CRC16: "CRC-16"}
    rows = {row[1]: row for row in section("Messages") if row[0].startswith("0x")}
    assert list(rows) == [function.name for function in Function]
    for function, layout in LAYOUTS.items():
        code, _, _, shape, check, node, _ = rows[function.name]
        form = {None: "any", False: "classic", True: "FD"}[layout.is_fd]
        assert int(code, 16) == function
        assert shape == f"{form}, {'any' if layout.length < 0 else layout.length}"
        assert check == names[layout.check]
        nodes = f"{layout.lowest_node}–{layout.highest_node}" if layout.highest_node else "0"
        assert node == nodes


def test_code_tables() -> None:
    cells = section("Codes")
    states = {
        row[1]: int(row[0]) for row in cells if row[0].isdigit() and len(row) == 6 and row[1] in DriveState.__members__
    }
    assert states == {state.name: int(state) for state in DriveState}
    controls = {row[3]: 1 << int(row[2]) for row in cells if row[3] in Control.__members__ and row[2].isdigit()}
    assert controls == {"ENABLE": Control.ENABLE, "FAULT_RESET": Control.FAULT_RESET}
    ops = {row[5]: int(row[4], 16) for row in cells if row[4].startswith("0x")}
    assert ops == {op.name: int(op) for op in ParamOp}
    pairs = [(row[i + 1], row[i]) for row in cells for i in (0, 2, 4)]
    faults = {name: int(code) for name, code in pairs if name in FaultReason.__members__ and code.isdigit()}
    assert faults == {fault.name: int(fault) for fault in FaultReason}


def test_parameter_table() -> None:
    rows = [row for row in section("Parameters") if row[0].startswith("0x")]
    expected = [
        [
            f"0x{row.number:04X}",
            row.name,
            row.unit,
            row.access.value,
            str(row.minimum),
            str(row.maximum),
            "–" if row.default is None else str(row.default),
        ]
        for row in DICTIONARY
    ]
    assert rows == expected


def test_worked_example() -> None:
    rows = [row for row in section("Worked example") if row[1].startswith("0x")]
    assert len(rows) == 12
    for name, identifier, payload, packet in rows:
        data = b"" if payload == "–" else bytes.fromhex(payload.strip("`"))
        frame = Frame(int(identifier, 16), data, name.startswith("FD_"))
        assert frame.arbitration_id >> 5 == Function[name]
        assert encode_serial(frame).hex(" ") == packet.strip("`")
        assert SerialReader().feed(bytes.fromhex(packet.strip("`"))) == [frame]
        decoder = codec.Decoder()
        assert decoder.decode(frame) is not None
    assert codec.encode_feedback(1, 0x400000, 1060, 200).data.hex(" ") == rows[0][2].strip("`")


def classic_bits(n: int) -> tuple[int, int]:
    """SOF 1, id 11, RTR, IDE, r0, DLC 4, data, CRC 15: may be stuffed; delimiters, ACK, EOF 7, space 3: 13 more."""
    stuffed = 1 + 11 + 3 + 4 + 8 * n + 15
    return stuffed + 13, stuffed + 13 + (stuffed - 1) // 4


def fd_us(n: int) -> tuple[float, float]:
    """17 bits to BRS and 12 after the CRC delimiter at 1 Mbit/s, the rest at 5."""
    nominal, data = 17 + 12, 1 + 4 + 8 * n + 4 + 17 + 6 + 1
    dynamic = (17 + 1 + 4 + 8 * n - 1) // 4
    slow = min(dynamic, 4)
    return nominal + data / 5, nominal + slow + (data + dynamic - slow) / 5


def test_bus_load() -> None:
    assert classic_bits(8) == (111, 135)
    assert [classic_bits(n)[0] == 47 + 8 * n for n in range(9)] == [True] * 9
    assert [classic_bits(n)[1] - classic_bits(n)[0] == (33 + 8 * n) // 4 for n in range(9)] == [True] * 9
    table = {row[0]: row[1:] for row in section("Load of the bus")}
    for name, count in (
        ("SETPOINT, FEEDBACK, TIMING", 3000),
        ("BENCH_SENSOR", 1000),
        ("HOST_HEARTBEAT, DRIVE_HEARTBEAT", 60),
        ("classic, all of it", 4060),
    ):
        loads = [f"{bits * count / 1e4:.1f} %" for bits in classic_bits(8)]
        assert table[name] == [str(count), *loads]
    both = [sum(pair) for pair in zip(fd_us(8), fd_us(16), strict=True)]
    assert table["FD_SETPOINT, FD_FEEDBACK"] == ["2000", *(f"{us / 10:.1f} %" for us in both)]
    assert "2.4 kHz (three frames with all stuffing take 405 µs), the FD variant at 7.8 kHz" in SPEC
    assert pytest.approx(2.4, abs=0.1) == 1e3 / 405
    assert 1e3 / both[1] == pytest.approx(7.8, abs=0.05)


def test_serial_rate() -> None:
    """HFP-167: what a period takes, at 8N1."""
    frames = [
        codec.encode_feedback(1, 0, 0, 0),
        codec.encode_timing(1, 0, 0, 0, 0, 0),
        codec.encode_setpoint(1, 0, 0, 0),
    ]
    assert sum(len(encode_serial(frame)) for frame in frames) == 42
