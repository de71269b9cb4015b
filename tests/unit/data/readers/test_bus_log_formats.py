"""What other programs write as a bus log: read as they mean it, and of damage the place is told."""

import struct
from collections.abc import Callable
from pathlib import Path

import can
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol.frames import Frame
from hil_forceps.data.readers.bus_logs.account import FD_LENGTHS, Account, LoggedFrame
from hil_forceps.data.readers.bus_logs.frames import read_frames
from hil_forceps.data.readers.format import Choice
from hil_forceps.data.readers.read_run import read_run
from hil_forceps.data.run import Run
from hil_forceps.rig.errors import UserError
from tests.reader_fuzz import sound_logs
from tests.reader_fuzz.sound_logs import BEGIN_NS, Timed, traffic

COUNT = 40
DATES = "its dates are those of the clock of the recording computer"
TRAFFIC = traffic(COUNT)
FRAMES = [frame for _, frame in TRAFFIC]


def read(path: Path, content: bytes) -> tuple[list[LoggedFrame], Account]:
    path.write_bytes(content)
    account = Account()
    return list(read_frames(path, account=account)), account


def times(found: list[LoggedFrame]) -> list[int]:
    return [each.time_ns - (found[0].time_ns or 0) for each in found if each.time_ns is not None]


def same(left: Run, right: Run) -> bool:
    return left.columns.keys() == right.columns.keys() and all(
        left.columns[name].tobytes() == right.columns[name].tobytes() for name in left.columns
    )


WRITERS: dict[str, Callable[[list[Timed]], bytes]] = {
    "candump.log": lambda frames: b"".join(sound_logs.candump(frames)),
    **{
        f"-t{stamps}.log": lambda frames, stamps=stamps: b"".join(sound_logs.printed(frames, stamps))  # type: ignore[misc]
        for stamps in "aAz"
    },
    **{
        f"{stamps}{base}.asc": lambda frames, s=stamps, b=base: b"".join(sound_logs.asc(frames, s, b))  # type: ignore[misc]
        for stamps in ("absolute", "relative")
        for base in (10, 16)
    },
    **{
        f"{version}.trc": lambda frames, version=version: b"".join(sound_logs.trc(frames, version))  # type: ignore[misc]
        for version in ("1.1", "1.2", "1.3", "2.0", "2.1")
    },
    **{
        f"{version}{packed}{size}.blf": lambda frames, v=version, p=packed, s=size: sound_logs.blf(  # type: ignore[misc]
            sound_logs.blf_objects(frames, v), s, packed=p
        )
        for version in (1, 2)
        for packed in (True, False)
        for size in (70, 1 << 17)
    },
}


@pytest.mark.parametrize("name", WRITERS)
def test_every_way_to_write_it_gives_the_same_frames_times_and_run(name: str, tmp_path: Path) -> None:
    found, account = read(tmp_path / name, WRITERS[name](TRAFFIC))
    assert [each.frame for each in found] == FRAMES
    assert times(found) == [t - BEGIN_NS for t, _ in TRAFFIC]
    assert len({each.bus for each in found}) == 1
    assert account.told() == (() if name != "-tA.log" else (DATES,))
    (tmp_path / "bus.log").write_bytes(WRITERS["candump.log"](TRAFFIC))
    (expected,), (run,) = read_run(tmp_path / "bus.log"), read_run(tmp_path / name)
    assert same(run, expected)
    assert {"theta_m_ref_rad", "theta_j_rad", "tau_w_N_m"} <= set(run.columns)


def test_a_log_without_times_can_be_looked_at_and_is_no_run(tmp_path: Path) -> None:
    found, _ = read(tmp_path / "a.log", b"".join(sound_logs.printed(TRAFFIC, "")))
    assert [each.frame for each in found] == FRAMES
    assert {each.time_ns for each in found} == {None}
    with pytest.raises(UserError, match="its frames have no times; record with candump -L, or print with candump -ta"):
        read_run(tmp_path / "a.log")


def test_times_since_the_frame_before_are_no_times(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"a\.log:6: its stamps go back: .*candump -td.*; record with candump -L"):
        read(tmp_path / "a.log", b"".join(sound_logs.printed(TRAFFIC, "d")))


@pytest.mark.parametrize(
    ("line", "told"),
    [
        (b"# a comment\n\n; another\n// and another\n", ""),
        (b"\tcontroller-problem{rx-error-warning}\n", ""),
        (b"DROPCOUNT: dropped 3 CAN frames on 'can0' socket (total drops 3)\n", "candump lost frames"),
        (b"(1700000000.001200) can0 20000080#0000000000000000\n", ""),
        (b"(1700000000.001200) can0 92345678#00\n(1700000000.0012) can0 081#R\n(1700000000.0012) can0 081#R8\n", ""),
        (b"hello\n", "line 9 ('hello')"),
        (bytes(70_000) + b"\n", "line 9 (zero bytes"),
        (b"\xff\xfe\x80\n", "line 9 ('"),
        (b"x" * 5000 + b"\n", "line 9 (a line of more than"),
        (b"(1700000000.001200) can0 081#001\n", "line 9 ("),
        (b"(1700000000.001200) can0 081#" + b"00" * 9 + b"\n", "line 9 ("),
        (b" can0  081   [8]  00 00 00 00 00 00 00 00\n", "line 9 (no stamps, after seconds since 1970)"),
    ],
)
def test_lines_that_are_no_frames(line: bytes, told: str, tmp_path: Path) -> None:
    lines = sound_logs.candump(TRAFFIC)
    found, account = read(tmp_path / "a.log", b"".join([*lines[:8], line, *lines[8:]]))
    assert [each.frame for each in found] == FRAMES
    assert told in " ".join(account.told())
    assert bool(account.told()) == bool(told)


def test_windows_leaves_marks_line_ends_and_letters(tmp_path: Path) -> None:
    log = b"\xef\xbb\xbf" + b"".join(sound_logs.candump(TRAFFIC)).replace(b"\n", b"\r\n")
    assert [each.frame for each in read(tmp_path / "a.log", log)[0]] == FRAMES
    for name in ("absolute16.asc", "2.1.trc"):
        first, rest = WRITERS[name](TRAFFIC).split(b"\n", 1)
        comment = b"// gr\xf6\xdfer\r\n" if name.endswith("asc") else b";  gr\xf6\xdfer\r\n"
        found, account = read(tmp_path / name, first + b"\n" + comment + rest.replace(b"\n", b"\r\n"))
        assert [each.frame for each in found] == FRAMES
        assert account.told() == ()
    with pytest.raises(UserError, match="is UTF-16; save it as UTF-8"):
        read(tmp_path / "b.log", log.decode().encode("utf-16"))


def test_the_end_of_a_log_that_was_cut_off_is_told(tmp_path: Path) -> None:
    whole = b"".join(sound_logs.candump(TRAFFIC))
    found, account = read(tmp_path / "a.log", whole[:-3])
    assert [each.frame for each in found] == FRAMES[:-1]
    assert "line 160 (the end of the file, within a line)" in account.told()[0]
    found, account = read(tmp_path / "a.log", whole + bytes(9000))
    assert [each.frame for each in found] == FRAMES
    assert "line 161 (zero bytes, as after a power cut)" in account.told()[0]


def test_a_relative_log_ends_where_an_event_is_lost(tmp_path: Path) -> None:
    lines = sound_logs.asc(TRAFFIC, "relative")
    found, account = read(tmp_path / "a.asc", b"".join([*lines[:20], b"   0.000x97 1  81  Rx   d 0\n", *lines[20:]]))
    assert [each.frame for each in found] == FRAMES[: len(found)]
    assert 10 < len(found) < 20
    assert "with relative stamps the following frames have no time" in " ".join(account.told())
    absolute = sound_logs.asc(TRAFFIC)
    found, account = read(
        tmp_path / "a.asc", b"".join([*absolute[:20], b"   0.000x97 1  81  Rx   d 0\n", *absolute[20:]])
    )
    assert [each.frame for each in found] == FRAMES
    assert (account.unreadable, account.damage) == (1, "")


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (
            lambda log: log.replace(b"base hex  timestamps absolute\n", b""),
            r"write `base hex timestamps absolute`",
        ),
        (lambda log: log.replace(b"timestamps absolute", b""), r"has no origin of the stamps"),
        (
            lambda log: (
                log.replace(b"absolute", b"relative").replace(b"End TriggerBlock", b"Begin Triggerblock x") + b"x"
            ),
            "a second trigger block",
        ),
    ],
)
def test_asc_that_leaves_its_times_open_is_refused(change: Callable[[bytes], bytes], told: str, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=told):
        read(tmp_path / "a.asc", change(b"".join(sound_logs.asc(TRAFFIC))))


def test_asc_events_of_every_kind(tmp_path: Path) -> None:
    """Lines of Vector's tools, as they stand in python-can's `test/data`, and what each of them is."""
    lines = [
        "0.015991 CAN 1 Status:chip status error passive - TxErr: 132 RxErr: 0",
        "1.015991 1  Statistic: D 0 R 0 XD 0 XR 0 E 0 O 0 B 0.00%",
        "3.098426 1  18EBFF00x       Rx d 8 01 A0 0F A6 60 3B D1 40    Length = 273910 BitCount = 141 ID = 418119424x",
        "3.297743 1  J1939TP FEE3p        6    0  0   -   Rx   d 23 A0 0F A6 60",
        "4.1 1  ErrorFrame",
        "4.2 2  ErrorFrame	Flags = 0xe	CodeExt = 0x20a2	Code = 0x82	ID = 0	DLC = 0	Position = 5	Length = 11300",
        "4.3 CANFD 1 Rx ErrorFrame",
        "4.4 1 6F8 TxRq d 8 FF 00 0C FE 00 00 00 00",
        "4.5 1 6F8 Rx r",
        "4.6 1 6F8 Rx r 8",
        "17.876976 1  6F8             Rx   d 8 FF 00 0C FE 00 00 00 00  Length = 239910 BitCount = 124 ID = 1784",
        "18.0 CANFD   2 Rx         7d  BrakeSnData_4  1 0 8  8 01 1b d6 d0 8a 1f d7 f6   104812  132   323000 a800",
        "18.1 CANFD   2 Rx         88                                   0 1 f 64 " + "11 " * 64 + " 1 2 3000 0",
        "18.2 CANFD   2 Rx         89                                   0 0 2  2 01 02   105812  137   2000 d001b0b3",
        "18.3 CANFD   2 Rx        167x  VehicleOperatingModes            1 0 8  8 73 80 00 10 00 09 e3 00",
        "18.4 CANFD   2 Rx        1B                                    0 0 5  0 140000 73 200050",
        "18.5 CANFD   2 Rx         88                                   0 1 f 48 " + "11 " * 48,
    ]
    found, account = read(tmp_path / "a.asc", b"".join(sound_logs.asc([])[:1]) + "\n".join([*lines, ""]).encode())
    assert [(each.bus, each.frame) for each in found] == [
        ("1", Frame(0x18EBFF00, bytes.fromhex("01A00FA6603BD140"), False, True)),
        ("1", Frame(0x6F8, bytes.fromhex("FF000CFE00000000"))),
        ("2", Frame(0x7D, bytes.fromhex("011bd6d08a1fd7f6"), True)),
        ("2", Frame(0x88, b"\x11" * 64, True)),
        ("2", Frame(0x89, b"\1\2", False)),
        ("2", Frame(0x167, bytes.fromhex("738000100009e300"), True, True)),
    ]
    assert account.others == {"event": 3, "error": 3, "request": 1, "remote": 3}
    assert account.unreadable == 1
    assert account.first_unreadable.startswith("line 20")


def test_trc_of_unknown_versions_and_columns_is_refused(tmp_path: Path) -> None:
    log = b"".join(sound_logs.trc(TRAFFIC))
    for change, told in (
        ((b"=2.1", b"=3.0"), "a.trc:1: TRC of version '3.0'; 1.0 to 2.1 are read"),
        ((b"L,D", b"D,L"), "the data must be the last"),
        ((b"N,O", b"N"), "must contain time, type, id and length"),
        ((b";$COLUMNS=N,O,T,B,I,d,R,L,D", b";"), r"a.trc:5: no line ;\$COLUMNS="),
    ):
        with pytest.raises(UserError, match=told):
            read(tmp_path / "a.trc", log.replace(*change))


def test_trc_events_of_every_kind(tmp_path: Path) -> None:
    lines = [
        ";$FILEVERSION=2.1\n;$COLUMNS=N,O,T,B,I,d,R,L,D",
        "1     17535.400 DT 1  00000100 Tx -  8    00 00 00 00 00 00 00 00",
        "2     17540.300 ST 1         - Rx -  4    00 00 00 08",
        "3     17541.300 ER 1         - Rx -  5    04 00 02 00 00",
        "4     17542.300 RR 1      0300 Rx -  8",
        "5     17543.300 EV User-defined event",
        "6     17544.300 FB 2      0300 Rx -  9    " + "AA " * 12,
        "7     17545.300 DT 1      0300 Rx -  0",
        "8     17546.300 DT 1      0300 Rx -  2    AA",
    ]
    found, account = read(tmp_path / "a.trc", "\n".join([*lines, ""]).encode())
    assert [(each.bus, each.frame) for each in found] == [
        ("1", Frame(0x100, bytes(8), False, True)),
        ("2", Frame(0x300, b"\xaa" * 12, True)),
        ("1", Frame(0x300, b"")),
    ]
    assert account.others == {"event": 2, "error": 1, "remote": 1}
    assert account.first_unreadable.startswith("line 10 ")


@pytest.mark.parametrize(
    ("size", "told"),
    [(0, "has the length 0 bytes"), (15, "has the length 15 bytes"), (0xFFFFFFFF, "has the length 4294967295 bytes")],
)
@pytest.mark.parametrize("packed", [True, False])
def test_a_blf_object_that_lies_about_its_size_ends_the_reading(
    size: int, told: str, packed: bool, tmp_path: Path
) -> None:
    objects = sound_logs.blf_objects(TRAFFIC)
    at = objects.index(b"LOBJ", 5 * 48)
    objects = objects[: at + 8] + struct.pack("<L", size) + objects[at + 12 :]
    found, account = read(tmp_path / "a.blf", sound_logs.blf(objects, 1 << 17, packed=packed))
    assert [each.frame for each in found] == FRAMES[:5]
    assert account.damage.startswith("the container at byte 144, where an object")
    assert told in account.damage


def test_blf_damage_of_other_kinds_is_told_with_its_place(tmp_path: Path) -> None:
    whole = sound_logs.blf(sound_logs.blf_objects(TRAFFIC), 48 * 8, packed=True)
    second = whole.index(b"LOBJ", 150)
    for changed, told in (
        (whole[: second + 90], f"the container at byte {second}, which is cut off"),
        (whole[: second + 4], f"byte {second}: the end of the file, within an object"),
        (whole[: second + 33] + b"\xff" + whole[second + 34 :], f"at byte {second}, which can't be unpacked"),
        (whole[:second] + b"JUNK" + whole[second + 4 :], f"byte {second}, where no object begins"),
        (whole[: second + 8] + bytes(4) + whole[second + 12 :], f"byte {second}, where an object has the length 0"),
        (whole[: second + 8] + b"\xff" * 4 + whole[second + 12 :], "where an object has the length 4294967295"),
        (whole[: second + 16] + b"\x07" + whole[second + 17 :], "packed by method 7; only zlib"),
    ):
        found, account = read(tmp_path / "a.blf", changed)
        assert [each.frame for each in found][:8] == FRAMES[:8]
        assert len(found) < 17
        assert told in account.damage
    with pytest.raises(UserError, match="not a BLF file"):
        read(tmp_path / "a.blf", b"")
    with pytest.raises(UserError, match="its header is damaged"):
        read(tmp_path / "a.blf", whole[:40])


def test_a_blf_frame_without_a_unit_of_time_is_left_out(tmp_path: Path) -> None:
    objects = bytearray(sound_logs.blf_objects(TRAFFIC))
    objects[16] = 3
    found, account = read(tmp_path / "a.blf", sound_logs.blf(bytes(objects), 1 << 17, packed=True))
    assert [each.frame for each in found] == FRAMES[1:]
    assert "whose time is in no known unit (flags 3)" in account.told()[0]


def two_buses() -> bytes:
    lines = zip(sound_logs.candump(TRAFFIC, "can0"), sound_logs.candump(traffic(COUNT, 2), "can1"), strict=True)
    return b"".join(line for pair in lines for line in pair)


def test_drives_on_two_buses_are_no_run_until_one_is_chosen(tmp_path: Path) -> None:
    path = tmp_path / "two.log"
    path.write_bytes(two_buses())
    told = r"2 buses have drives: can0 node 1 \(160 frames\), can1 node 2 \(160 frames\); choose one with --bus"
    with pytest.raises(UserError, match=told):
        read_run(path)
    (tmp_path / "one.log").write_bytes(b"".join(sound_logs.candump(TRAFFIC)))
    assert same(read_run(path, choice=Choice("can0"))[0], read_run(tmp_path / "one.log")[0])
    with pytest.raises(UserError, match="contains no frame of bus 'can7'; use --bus with one of: can0, can1"):
        read_run(path, choice=Choice("can7"))
    with pytest.raises(UserError, match=r"does not contain node 1; use --node with one of node 2 \(160 frames\)"):
        read_run(path, choice=Choice("can1", 1))


def test_one_node_of_several_may_be_chosen(tmp_path: Path) -> None:
    path = tmp_path / "two.log"
    path.write_bytes(two_buses().replace(b"can1", b"can0"))
    assert [run.name for run in read_run(path)] == ["two-node1-1", "two-node2-2"]
    assert [run.name for run in read_run(path, choice=Choice(node=2))] == ["two"]


def test_time_that_goes_back_is_told(tmp_path: Path) -> None:
    lines = sound_logs.candump(TRAFFIC)
    (tmp_path / "a.log").write_bytes(b"".join([*lines[:40], lines[41], lines[40], *lines[42:]]))
    (run,) = read_run(tmp_path / "a.log")
    assert "the log's time goes back 1 times, by 0.1 ms at most" in run.notes


# --- python-can as the referee: what its writers write and its readers read -----------------------------------

payloads = st.one_of(
    st.tuples(st.just(False), st.binary(max_size=8)),
    st.tuples(st.just(True), st.sampled_from(FD_LENGTHS[1:]).flatmap(lambda n: st.binary(min_size=n, max_size=n))),
)
kinds = st.sampled_from(["data", "data", "data", "extended", "remote", "error"])
messages = st.lists(st.tuples(st.integers(0, 0x7FF), payloads, kinds, st.integers(0, 999_999)), min_size=1, max_size=20)


@settings(max_examples=60, deadline=None)
@given(drawn=messages, suffix=st.sampled_from([".log", ".asc", ".blf", ".trc"]))
def test_python_can_agrees_about_sound_logs(
    drawn: list[tuple[int, tuple[bool, bytes], str, int]], suffix: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.getbasetemp() / f"referee{suffix}"
    time_us = 1_700_000_000_000_000
    written = []
    with can.Logger(path) as log:
        for identifier, (is_fd, data), kind, later_us in drawn:
            if suffix == ".trc" and (is_fd or kind in {"remote", "error"}):
                continue  # its writer of TRC leaves these out
            time_us += later_us
            is_plain, is_extended = kind in {"data", "extended"}, kind == "extended"
            identifier = identifier << 18 | 0x2_0001 if is_extended else identifier  # noqa: PLW2901
            frame = Frame(identifier, data, is_fd, is_extended) if is_plain else Frame(identifier, data[:8], False)
            written += [(time_us, frame)] * is_plain
            log.on_message_received(
                can.Message(
                    timestamp=time_us * 1e-6,
                    arbitration_id=identifier,
                    data=None if kind == "remote" else frame.data,
                    is_fd=frame.is_fd,
                    bitrate_switch=frame.is_fd,
                    is_extended_id=is_extended,
                    is_remote_frame=kind == "remote",
                    is_error_frame=kind == "error",
                )
            )
    account = Account()
    found = list(read_frames(path, account=account)) if path.stat().st_size else []
    assert [each.frame for each in found] == [frame for _, frame in written]
    assert account.told() == ()
    with can.LogReader(path) as referee:
        theirs = [m for m in referee if not (m.is_error_frame or m.is_remote_frame)]
    shown = [(m.arbitration_id, bytes(m.data), m.is_fd, m.is_extended_id) for m in theirs]
    assert shown == [tuple(each.frame) for each in found]

    for mine, message in zip(found, theirs, strict=True):
        since_first_s = ((mine.time_ns or 0) - (found[0].time_ns or 0)) * 1e-9
        assert since_first_s == pytest.approx(message.timestamp - theirs[0].timestamp, abs=3e-6)
