"""The golden vectors are up to date, and reading them alone is enough to check an implementation."""

import json
import runpy
from importlib import resources
from typing import Any

import pytest

from firmware_protocol import codec, golden
from firmware_protocol import messages as all_messages
from firmware_protocol.drive.machine import DriveConfig, DriveMachine
from firmware_protocol.frames import Frame
from firmware_protocol.messages import DriveState, FaultReason, Function
from firmware_protocol.scales import wrap_int32
from firmware_protocol.serial_framing import SerialReader, encode_serial

TEXT = (resources.files("firmware_protocol") / "golden" / "vectors.json").read_text(encoding="utf-8")
VECTORS: dict[str, Any] = json.loads(TEXT)


def frame_of(row: dict[str, Any]) -> Frame:
    return Frame(row["id"], bytes.fromhex(row["payload"]), row["fd"])


def test_the_file_is_what_the_generator_writes() -> None:
    assert golden.document() == TEXT
    assert golden.document() == golden.document()


def test_the_command_writes_the_file(capsys: pytest.CaptureFixture[str]) -> None:
    runpy.run_module("firmware_protocol.golden", run_name="__main__")
    assert capsys.readouterr().out == TEXT


def test_messages_replay() -> None:
    names = {"FD_SETPOINT": "Setpoint", "FD_FEEDBACK": "FdFeedback"}
    for row in VECTORS["messages"]:
        kind = getattr(all_messages, names.get(row["message"], row["message"].title().replace("_", "")))
        message, frame = kind(**row["fields"]), frame_of(row)
        assert codec.encode(message, fd=row["message"] == "FD_SETPOINT") == frame
        assert codec.Decoder().decode(frame) == message
        assert encode_serial(frame).hex() == row["serial"]
        assert SerialReader().feed(bytes.fromhex(row["serial"])) == [frame]
    assert {row["message"] for row in VECTORS["messages"]} == {function.name for function in Function}


def test_rejects_replay() -> None:
    for row in VECTORS["rejects"]:
        decoder = codec.Decoder()
        assert decoder.decode(frame_of(row)) is None
        assert {name for name, count in decoder.counters.items() if count} == {row["counter"]}


@pytest.mark.parametrize("size", [1, 3, 1000])
def test_serial_streams_replay(size: int) -> None:
    for row in VECTORS["serial_streams"]:
        reader, stream = SerialReader(), bytes.fromhex(row["stream"])
        frames = [frame for i in range(0, len(stream), size) for frame in reader.feed(stream[i : i + size])]
        assert frames == [frame_of(f) for f in row["frames"]]
        assert reader.counters == row["counters"]


@pytest.mark.parametrize("scenario", VECTORS["drive_scenarios"], ids=lambda s: s["name"])
def test_drive_scenarios_replay(scenario: dict[str, Any]) -> None:
    """With the clock and the angle as the wire has them: wrapped."""
    config = scenario["config"]
    drive = DriveMachine(DriveConfig(**{**config, "fd": bool(config["fd"])}))
    for step in scenario["steps"]:
        frames: list[Frame] = []
        match step["event"]:
            case "receive":
                frames = drive.receive(frame_of(step), step["now_us"], step["theta_m"])
            case "poll":
                frames = drive.poll(step["now_us"])
            case "sample":
                frames = drive.sample(step["now_us"], step["theta_m"], step["current"])
            case "trip":
                drive.trip(FaultReason(step["reason"]))
        assert frames == [frame_of(frame) for frame in step["frames"]]
        reference = None if drive.reference_raw is None else wrap_int32(drive.reference_raw)
        assert (drive.state, drive.fault, reference) == (step["state"], step["fault"], step["reference"])
    assert drive.counters == scenario["counters"]


def test_the_scenarios_see_every_state_and_every_fault_of_the_protocol() -> None:
    steps = [step for scenario in VECTORS["drive_scenarios"] for step in scenario["steps"]]
    assert {step["state"] for step in steps} == {int(state) for state in DriveState}
    protocol_faults = set(FaultReason) - {
        FaultReason.ENCODER,  # the device's own, and all alike
        FaultReason.SUPPLY,
        FaultReason.OVERTEMPERATURE,
        FaultReason.BUS_OFF,
        FaultReason.INTERNAL,
    }
    assert {step["fault"] for step in steps} == {int(fault) for fault in protocol_faults}
    assert {step["event"] for step in steps} == {"receive", "poll", "sample", "trip"}
