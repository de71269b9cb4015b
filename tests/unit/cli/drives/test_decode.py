"""`hil-forceps decode`: frames, logs of all kinds, serial captures and stdin in all forms."""

import csv
import io
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import can
import pytest

from firmware_protocol import codec
from firmware_protocol.frames import Frame
from firmware_protocol.messages import Control, DriveState, FaultReason, Feedback, HostHeartbeat
from firmware_protocol.scales import ANGLE_LSB_RAD, CURRENT_LSB_A
from firmware_protocol.serial_framing import encode_serial
from hil_forceps.cli.main import main

ROOT = Path(__file__).parents[4]
COUNT = 50
FRAMES = [codec.encode(Feedback(1, 1_000 * i, -7 * i, i)) for i in range(COUNT)]

Call = Callable[..., tuple[int, str, str]]


def text_of(frame: Frame) -> str:
    return f"{frame.arbitration_id:03X}#{frame.data.hex().upper()}"


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Call:
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str, stdin: str = "") -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "stdin", io.StringIO(stdin))
        with pytest.raises(SystemExit) as ended:
            main(["decode", *arguments])
        out, err = capsys.readouterr()
        assert isinstance(ended.value.code, int)
        return ended.value.code, out, err

    return run


def message(frame: Frame, time_s: float, **more: bool) -> can.Message:
    return can.Message(
        timestamp=time_s, arbitration_id=frame.arbitration_id, data=frame.data, **{"is_extended_id": False, **more}
    )


def write_log(path: Path, frames: list[Frame]) -> None:
    with can.Logger(path) as log:
        for i, frame in enumerate(frames):
            log.on_message_received(message(frame, 1.0 + 0.001 * i))


def test_frame_as_text(call: Call) -> None:
    code, out, err = call(text_of(FRAMES[3]))
    assert (code, err) == (0, "")
    assert out.split() == [
        text_of(FRAMES[3]),
        "Feedback",
        "node=1",
        f"theta_m_rad={3000 * ANGLE_LSB_RAD:.9g}",
        f"current_A={-21 * CURRENT_LSB_A:.9g}",
        "sequence=3",
    ]


def test_json_lines_are_in_si_with_words(call: Call) -> None:
    beat = codec.encode(HostHeartbeat(1, int(Control.ENABLE), 5, 1, 0))
    code, out, _ = call("--form", "jsonl", text_of(FRAMES[2]), text_of(beat))
    assert code == 0
    first, second = (json.loads(line) for line in out.splitlines())
    assert first["message"] == "Feedback"
    assert first["theta_m_rad"] == 2000 * ANGLE_LSB_RAD
    assert first["current_A"] == pytest.approx(-14 * CURRENT_LSB_A)
    assert first["data"] == FRAMES[2].data.hex()
    assert first["time_s"] is None
    assert second["message"] == "HostHeartbeat"
    assert second["control"] == "ENABLE"


def test_states_and_reasons_are_words() -> None:
    from firmware_protocol.messages import DriveHeartbeat  # noqa: PLC0415
    from hil_forceps.cli.commands.drives.decode import signals  # noqa: PLC0415

    known = dict.fromkeys(DriveHeartbeat._fields, 0)
    told = signals(DriveHeartbeat(**{**known, "state": int(DriveState.FAULT), "fault": int(FaultReason.WATCHDOG)}))
    assert (told["state"], told["fault"]) == ("FAULT", "WATCHDOG")
    assert signals(DriveHeartbeat(**{**known, "fault": 200}))["fault"] == 200


def test_csv_has_a_row_for_each_signal(call: Call) -> None:
    code, out, _ = call("--form", "csv", text_of(FRAMES[2]), "fff#00")
    assert code == 1
    rows = list(csv.DictReader(io.StringIO(out)))
    assert {row["signal"]: row["value"] for row in rows[:-1]} == {
        "node": "1",
        "theta_m_rad": str(2000 * ANGLE_LSB_RAD),
        "current_A": str(-14 * CURRENT_LSB_A),
        "sequence": "2",
    }
    assert rows[-1]["message"] == "refused: unknown_id"


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf", ".trc", ".LOG"])
def test_logs_of_all_kinds_give_every_frame(call: Call, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"bus{suffix}"
    write_log(path, FRAMES)
    code, out, err = call("--form", "jsonl", str(path))
    assert (code, err) == (0, "")
    rows = [json.loads(line) for line in out.splitlines()]
    assert [row["sequence"] for row in rows] == list(range(COUNT))
    assert [bytes.fromhex(row["data"]) for row in rows] == [frame.data for frame in FRAMES]
    times = [row["time_s"] - rows[0]["time_s"] for row in rows]
    assert times == pytest.approx([0.001 * i for i in range(COUNT)], abs=2e-4)


def test_frames_of_others_are_left_out(call: Call, tmp_path: Path) -> None:
    path = tmp_path / "bus.log"
    with can.Logger(path) as log:
        log.on_message_received(message(FRAMES[0], 1.0))
        log.on_message_received(message(Frame(0x12345678, b"\1"), 1.1, is_extended_id=True))
        log.on_message_received(message(Frame(0x81, b""), 1.2, is_remote_frame=True))
        log.on_message_received(message(Frame(0, b""), 1.3, is_error_frame=True))
        log.on_message_received(message(FRAMES[1], 1.4))
    for arguments, stdin in (([str(path)], ""), (["-"], path.read_text())):
        code, out, err = call(*arguments, stdin=stdin)
        assert (code, err) == (0, "")
        assert out.count("Feedback") == out.count("\n") == 2


def test_a_bus_and_a_node_may_be_chosen(call: Call, tmp_path: Path) -> None:
    other = codec.encode(Feedback(2, 5, 6, 7))
    lines = [f"(1.{n:06d}) can{n % 2} {text_of(FRAMES[n] if n % 3 else other)}\n" for n in range(6)]
    (tmp_path / "two.log").write_text("".join(lines))
    for source in ("two.log", "-"):
        code, out, _ = call(source, "--form", "jsonl", stdin="".join(lines))
        assert (code, [json.loads(line)["bus"] for line in out.splitlines()]) == (0, ["can0", "can1"] * 3)
        code, out, _ = call(source, "--bus", "can1", stdin="".join(lines))
        assert (code, out.count("\n"), out.count(" can1 ")) == (0, 3, 3)
        code, out, _ = call(source, "--node", "2", stdin="".join(lines))
        assert (code, out.count("\n"), out.count("node=2")) == (0, 2, 2)
        code, out, err = call(source, "--bus", "can7", stdin="".join(lines))
        assert (code, out) == (2, "")
        assert "contains no frame of bus 'can7'; use --bus with one of: can0, can1" in err


def test_damage_to_a_log_is_told_behind_what_it_holds(call: Call, tmp_path: Path) -> None:
    write_log(tmp_path / "a.log", FRAMES)
    (tmp_path / "a.log").write_bytes((tmp_path / "a.log").read_bytes() + bytes(4096))
    code, out, err = call("a.log")
    assert (code, out.count("Feedback")) == (1, COUNT)
    assert f"at line {COUNT + 1} (zero bytes" in err
    assert err.count("\n") == 1


def test_json_has_no_nan(call: Call) -> None:
    input_position = "00C#0000C07F00000000"  # to an ODrive: NaN turns
    code, out, _ = call(input_position, "--drive", "odrive", "--form", "jsonl")
    assert code == 0
    assert json.loads(out, parse_constant=pytest.fail)["position_rev"] is None
    assert "position_rev=nan" in call(input_position, "--drive", "odrive")[1]


def test_standard_input_that_is_closed_is_told(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(io, "StringIO", lambda _: None)
    code, out, err = call("-")
    assert (code, out) == (2, "")
    assert err == "hil-forceps: decode -: standard input is closed; name a file instead\n"


def test_standard_output_that_is_closed_is_told(tmp_path: Path) -> None:
    done = shell(f"({installed(text_of(FRAMES[0]))} >&-)", tmp_path)
    assert done.stdout == "2\n"
    assert done.stderr == "hil-forceps: standard output is closed; redirect it to a file or to /dev/null\n"


def test_serial_capture(call: Call, tmp_path: Path) -> None:
    path = tmp_path / "line.bin"
    path.write_bytes(b"".join(map(encode_serial, FRAMES)))
    code, out, err = call(str(path))
    assert (code, err) == (0, "")
    assert out.count("Feedback") == COUNT
    broken = bytearray(path.read_bytes())
    broken[len(broken) // 2] ^= 0x10
    path.write_bytes(broken)
    code, out, err = call(str(path))
    assert code == 1
    assert COUNT - 2 <= out.count("Feedback") < COUNT
    assert err.startswith("hil-forceps: ")
    assert "of the serial capture contain no valid frame: bad_" in err


def test_stdin_takes_candump_lines(call: Call) -> None:
    lines = f"(1.500000) can0 {text_of(FRAMES[0])}\n\n{text_of(FRAMES[1])}\n(1.6) vcan0 {text_of(FRAMES[2])} R\n"
    code, out, err = call("-", "--form", "jsonl", stdin=lines)
    assert (code, err) == (0, "")
    assert [json.loads(line)["time_s"] for line in out.splitlines()] == [1.5, None, 1.6]


def test_what_can_not_be_decoded_is_shown_with_its_reason(call: Call) -> None:
    damaged = FRAMES[1]._replace(data=FRAMES[1].data[:-1] + bytes([FRAMES[1].data[-1] ^ 1]))
    short = FRAMES[2]._replace(data=FRAMES[2].data[:-1])
    code, out, err = call(text_of(FRAMES[0]), text_of(damaged), text_of(short), "7FF#00")
    assert code == 1
    assert [line.partition("refused: ")[2] for line in out.splitlines()] == ["", "bad_crc", "bad_length", "unknown_id"]
    assert err.startswith("hil-forceps: 3 of 4 frames could not be decoded; ")
    assert "--drive" in err


@pytest.mark.parametrize("text", ["081#1", "081#11zz", "81#11", "081#11 and more", "0000081#00", "#", "081#é"])
def test_text_that_is_no_frame_is_told(call: Call, text: str) -> None:
    code, out, err = call(text)
    assert (code, out) == (2, "")
    assert err.startswith(f"hil-forceps: argument:1: '{text}' is not a frame")
    assert err.count("\n") == 1


def test_line_of_stdin_is_named(call: Call) -> None:
    code, _, err = call("-", stdin=f"{text_of(FRAMES[0])}\nnonsense\n")
    assert code == 2
    assert err.startswith("hil-forceps: stdin:2: 'nonsense' is not a frame")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "no source"),
        (["none.log"], "none.log: no such file"),
        (["folder"], "folder: is a folder"),
        (["text.txt"], "unknown log format '.txt'; known formats: .asc .bin .blf .log .trc"),
        (["empty.blf"], "empty.blf: not a BLF file"),
        (["noise.log"], "noise.log: not readable as a .log log"),
        (["noise.asc"], "noise.asc: not readable as a .asc log"),
        (["noise.blf"], "noise.blf: not a BLF file"),
        (["--frob", "081#00"], "--frob: unknown option"),
        (["--form", "xml", "081#00"], "--form"),
    ],
)
def test_what_is_wrong_is_told_in_one_line(call: Call, tmp_path: Path, arguments: list[str], words: str) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "text.txt").write_text("a")
    (tmp_path / "empty.blf").touch()
    for suffix in ("log", "asc", "blf"):
        (tmp_path / f"noise.{suffix}").write_bytes(bytes(range(128, 256)) * 20)
    code, out, err = call(*arguments)
    assert (code, out) == (2, "")
    assert words in err
    assert err.count("\n") == 1


@pytest.mark.parametrize("name", ["empty.log", "empty.asc", "empty.trc", "empty.bin", "-"])
def test_nothing_in_it_is_told(call: Call, tmp_path: Path, name: str) -> None:
    (tmp_path / name).touch()
    code, out, err = call(name)
    assert (code, out, err) == (1, "", f"hil-forceps: no frames in {name}\n")


def installed(arguments: str) -> str:
    return f"'{sys.executable}' -m hil_forceps.cli.main decode {arguments}"


def shell(line: str, folder: Path) -> "subprocess.CompletedProcess[str]":
    buffered = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    return subprocess.run(
        ["bash", "-c", f"{line}; echo ${{PIPESTATUS[0]}}"],
        cwd=folder,
        env={**buffered, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=True,
    )


@pytest.mark.parametrize("count", [20, 20_000])
def test_reader_may_go_away(tmp_path: Path, count: int) -> None:
    (tmp_path / "a.txt").write_text("".join(f"{text_of(FRAMES[i % COUNT])}\n" for i in range(count)))
    done = shell(f"{installed('-')} < a.txt | head -1", tmp_path)
    first, code = done.stdout.splitlines()
    assert "Feedback" in first
    assert (code, done.stderr) == ("0", "")
    done = shell(f"{installed('-')} < a.txt | true", tmp_path)
    assert (done.stdout, done.stderr) == ("0\n", "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_output_that_can_not_be_written_is_told(tmp_path: Path) -> None:
    done = shell(f"{installed(text_of(FRAMES[0]))} > /dev/full", tmp_path)
    assert (done.stdout, done.stderr) == ("2\n", "hil-forceps: No space left on device\n")
