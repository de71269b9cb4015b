"""Packets of protocol 2.0: the maker's examples, others' packing both ways, torn and damaged bytes."""

import json
from pathlib import Path
from typing import Any

import pytest
from dynamixel_sdk.protocol2_packet_handler import Protocol2PacketHandler
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.frames import Frame
from hil_forceps.bridge.logs.bus_log import open_bus_log
from hil_forceps.data.readers.bus_logs.frames import read_frames
from hil_forceps.drives.dynamixel import packets as wire
from hil_forceps.drives.dynamixel.packets import Reader, encode
from hil_forceps.drives.dynamixel.profile import decode
from virtual_bus.drives import dynamixel_packets as peer

GOLDEN = json.loads((Path(__file__).parent / "golden.json").read_text())
IDS = st.integers(0, wire.MAX_ID) | st.just(wire.BROADCAST_ID)
LIVELY = st.sampled_from([0xFF, 0xFD, 0x00, 0x01, 0xFE])  # what headers and stuffing are made of
DATA = st.binary(min_size=1, max_size=wire.MAX_DATA_BYTES) | st.lists(
    LIVELY, min_size=1, max_size=wire.MAX_DATA_BYTES
).map(bytes)


@pytest.mark.parametrize("example", GOLDEN, ids=lambda each: each["name"])
def test_the_makers_examples(example: dict[str, Any]) -> None:
    packet = bytes.fromhex(example["packet"])
    frame = wire.packet(example["id"], bytes.fromhex(example["data"]))
    assert encode(frame) == packet
    reader = Reader()
    assert reader.feed(packet) == [frame]
    assert not any(reader.counters.values())
    assert peer.encode(frame) == packet
    assert peer.ServoReader().feed(packet) == [frame]
    decoded = decode(frame)
    if "instruction" in example:
        assert decoded == (example["instruction"], {"id": example["id"], **example.get("values", {})})
    else:
        assert decoded is None  # an instruction that this profile doesn't use


def test_what_is_asked_and_told_is_what_the_maker_asks_and_tells() -> None:
    by_name = {each["name"]: bytes.fromhex(each["packet"]) for each in GOLDEN}
    assert encode(wire.ping(1)) == by_name["ping"]
    assert encode(wire.ping(wire.BROADCAST_ID)) == by_name["ping of all"]
    assert encode(wire.read(1, 132, 4)) == by_name["read: Present Position"]
    assert encode(wire.write(1, 116, (512).to_bytes(4, "little"))) == by_name["write: Goal Position"]
    assert encode(wire.reboot(1)) == by_name["reboot"]


def unpacked_by_sdk(packet: bytes) -> bytes:
    """What ROBOTIS' own library makes of a packet: instruction and parameters; its CRC is checked."""
    handler = Protocol2PacketHandler()
    assert handler.updateCRC(0, packet[:-2], len(packet) - 2) == int.from_bytes(packet[-2:], "little")
    bare = handler.removeStuffing(list(packet))
    length = bare[5] | bare[6] << 8
    return bytes(bare[7 : 7 + length - 2])


def packed_by_sdk(frame: Frame) -> bytes:
    handler = Protocol2PacketHandler()
    length = len(frame.data) + 2
    head = [0xFF, 0xFF, 0xFD, 0x00, frame.arbitration_id, length & 0xFF, length >> 8]
    packet = handler.addStuffing([*head, *frame.data, 0, 0])
    crc = handler.updateCRC(0, packet, len(packet) - 2)
    return bytes([*packet[:-2], crc & 0xFF, crc >> 8])


@given(IDS, DATA)
def test_others_pack_the_same(servo_id: int, data: bytes) -> None:
    frame = wire.packet(servo_id, data)
    packet = encode(frame)
    assert packed_by_sdk(frame) == packet == peer.encode(frame)
    assert Reader().feed(packet) == [frame] == peer.ServoReader().feed(packet)


@given(IDS, st.binary(min_size=1, max_size=wire.MAX_DATA_BYTES))
def test_others_understand_what_is_packed(servo_id: int, data: bytes) -> None:
    assert unpacked_by_sdk(encode(wire.packet(servo_id, data.replace(b"\xff", b"\xfe")))) == data.replace(
        b"\xff", b"\xfe"
    )
    once = b"\x03\x74\x00\xff\xff\xfd\x00"
    assert unpacked_by_sdk(encode(wire.packet(servo_id, once))) == once


def test_the_sdk_does_not_send_what_it_has_stuffed() -> None:
    # DYNAMIXEL Protocol 2.0, Packet Process, order of transmission: stuffing, then length and CRC. The SDK's txPacket
    # drops the list that addStuffing returns, so its packets go out without.
    class Port:
        is_using = False

        def clearPort(self) -> None:
            pass

        def writePort(self, packet: list[int]) -> int:
            self.sent = bytes(packet)
            return len(packet)

    port, data = Port(), bytes.fromhex("03 74 00 ff ff fd 00")
    Protocol2PacketHandler().txPacket(port, [0, 0, 0, 0, 1, len(data) + 2, 0, *data, 0, 0])
    assert len(port.sent) == len(encode(wire.packet(1, data))) - 1
    assert b"\xff\xff\xfd\xfd" not in port.sent


def test_the_sdk_takes_too_much_out_behind_a_first_stuffed_byte() -> None:
    # DYNAMIXEL Protocol 2.0, Packet Process: FD is put behind FF FF FD, so FF FD FD stays what it is. The SDK looks
    # back into bytes that it has moved by then, and sees FF FF where there is one FF.
    data = bytes.fromhex("55 00 ff ff fd 00 00 ff fd fd 00")
    packet = encode(wire.packet(1, data))
    assert unpacked_by_sdk(packet) == bytes.fromhex("55 00 ff ff fd 00 00 ff fd 00")
    assert Reader().feed(packet)[0].data == data == peer.ServoReader().feed(packet)[0].data


@given(st.lists(st.tuples(IDS, DATA, st.binary(max_size=5)), max_size=6), st.lists(st.integers(1, 40), max_size=60))
def test_however_the_bytes_are_cut(parts: list[tuple[int, bytes, bytes]], cuts: list[int]) -> None:
    stream = b"".join(encode(wire.packet(servo_id, data)) + noise for servo_id, data, noise in parts)
    whole, piecewise = Reader(), Reader()
    expected = whole.feed(stream)
    found: list[Frame] = []
    at = 0
    for size in [*cuts, len(stream)]:
        found += piecewise.feed(stream[at : at + size])
        at += size
    found += piecewise.feed(stream[at:])
    assert found == expected
    assert piecewise.counters == whole.counters


def test_a_packet_that_was_cut_off_costs_no_other() -> None:
    torn, whole = encode(wire.read(1, 224, 10))[:8], encode(wire.ping(1))
    reader = Reader()
    assert reader.feed(torn + whole) == [wire.ping(1)]
    assert reader.counters["cut_off"] == 1


@pytest.mark.parametrize(
    ("packet", "counter"),
    [
        (encode(wire.ping(1))[:-1] + b"\x00", "bad_crc"),
        (bytes.fromhex("fffffd00010200"), "bad_length"),
        (bytes.fromhex("fffffd0001ff7f"), "bad_length"),
        (b"garbage", "skipped_bytes"),
    ],
)
def test_what_is_damaged_is_counted_and_the_next_is_taken(packet: bytes, counter: str) -> None:
    reader = Reader()
    assert reader.feed(packet + encode(wire.ping(7))) == [wire.ping(7)]
    assert reader.counters[counter] >= 1


def test_an_id_that_no_servo_has() -> None:
    head = bytes.fromhex("fffffd00ff030001")
    reader = Reader()
    assert reader.feed(head + peer.crc(head).to_bytes(2, "little")) == []
    assert reader.counters["bad_id"] == 1


@given(st.lists(st.binary(max_size=300) | st.lists(LIVELY, max_size=60).map(bytes), max_size=10))
def test_no_bytes_raise_and_memory_is_bounded(chunks: list[bytes]) -> None:
    reader, servo = Reader(), peer.ServoReader()
    for chunk in chunks:
        for frame in reader.feed(chunk):
            decode(frame)
        servo.feed(chunk)
    assert len(reader._partial) <= 7 + wire.MAX_DATA_BYTES * 4 // 3 + 2


@pytest.mark.parametrize(
    "frame", [Frame(253, b"\x01"), Frame(255, b"\x01"), Frame(-1, b"\x01"), Frame(1, b""), Frame(1, bytes(65))]
)
def test_a_packet_that_can_not_be_is_not_made(frame: Frame) -> None:
    with pytest.raises(ValueError, match=r"no servo|a packet has"):
        encode(frame)


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf"])
def test_every_bus_log_holds_packets_of_any_length(suffix: str, tmp_path: Path) -> None:
    frames = [wire.packet(each["id"], bytes.fromhex(each["data"])) for each in GOLDEN]
    log = open_bus_log(tmp_path / f"bus{suffix}", 0, threaded=False)
    log.add(True, [(1_000_000 * n, frame) for n, frame in enumerate(frames)])
    assert log.close().failure == ""
    assert [stamped.frame for stamped in read_frames(tmp_path / f"bus{suffix}")] == frames
