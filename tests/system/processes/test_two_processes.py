"""`drive` and `run` as two processes over a pty and over UDP multicast: frames accounted for, ends of all kinds.

Counts and ratios are asserted, never times; overruns may happen.
"""

import json
import signal
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from firmware_protocol.codec import Decoder
from firmware_protocol.frames import Frame
from firmware_protocol.messages import DriveState
from hil_forceps.bench.realtime import account
from hil_forceps.data.recording.reader import Recording, read_recording

pytestmark = [pytest.mark.realtime, pytest.mark.slow]

PAPER = Path(__file__).resolve().parents[3] / "configs" / "paper.yaml"
ATTEMPTS = 3  # at 1 kHz: a machine that stalls for 20 ms meets the watchdog, and that is no fault of the bench

# Fixtures of conftest.py; what they hand out is described there.
DriveFixture = Callable[..., Any]
RunFixture = Callable[..., Any]
Wait = Callable[..., None]


def result_of(out: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((out / "run.json").read_text())
    return content


def logged(out: Path) -> tuple[Counter[str], Counter[str], Counter[str]]:
    """Count the bus log by message: what came before the drive said who it is, what came since, what was sent."""
    decoder = Decoder()
    early, received, sent = Counter[str](), Counter[str](), Counter[str]()
    for line in (out / "bus.log").read_text().splitlines():
        _, _, text, direction = line.split()
        identifier, _, data = text.partition("#")
        message = decoder.decode(Frame(int(identifier, 16), bytes.fromhex(data), False))
        name = "" if message is None else type(message).__name__
        is_known = received or name == "Identity"
        (sent if direction == "T" else received if is_known else early)[name] += 1
    assert not (early | received | sent)[""], "frames in the log that nobody can decode"
    return early, received, sent


def check_whole(recording: Recording, reason: str) -> None:
    assert recording.notes == ()
    assert recording.result["reason"] == reason
    assert len(recording.samples) > 100
    assert np.all(np.diff(recording.samples["stamp_ns"]) > 0)


@pytest.mark.alone
def test_every_frame_is_accounted_for(
    drive: DriveFixture, run: RunFixture, wire: Any, tmp_path: Path, start: Any
) -> None:
    for attempt in range(ATTEMPTS):
        out = tmp_path / f"out{attempt}"
        other = drive(wire, rig=PAPER)
        ended = run(wire, out, "--duration", "2.5", rig=PAPER).end()
        told = other.end(signal.SIGTERM).told
        if not any(words in ended.err for words in ("WATCHDOG", "fell silent")):
            break
    assert (ended.code, ended.err) == (0, "")
    assert "completed" in ended.out
    result = result_of(out)
    assert (result["reason"], result["drive_disabled"]) == ("completed", True)
    host, service = result["counters"]["host"], result["counters"]["service"]
    early, received, sent = logged(out)
    recording = read_recording(out / "run.mcap")
    check_whole(recording, "completed")

    # drive to host: sequence numbers leave no gap that isn't counted, and all that came is in log and recording
    sequences = recording.samples["sequence"].astype(int)
    assert int(np.sum((np.diff(sequences) - 1) % 256)) == host["lost_feedback"]
    assert len(recording.samples) == host["samples"]
    assert len(recording.bench) == host["bench_samples"]
    assert early.total() == host["not_for_us"]
    assert received["Feedback"] == host["samples"] + host["stale_feedback"] + host["unpaired"]
    assert early.total() + received.total() == service["frames_received"]
    assert received["Feedback"] + host["lost_feedback"] <= told["sent"]["FEEDBACK"]
    assert host["lost_feedback"] <= 0.01 * host["samples"]

    # host to drive: what was sent is what was heard, or lost by the count of the drive
    references = recording.references[recording.references["outcome"] == 1]
    assert len(references) == service["references_sent"] == host["setpoints_sent"] == sent["Setpoint"]
    assert np.all(np.diff(references["setpoint_sequence"].astype(int)) % 256 == 1)
    assert told["received"]["SETPOINT"] + told["drive"]["setpoints_lost"] == host["setpoints_sent"]
    assert told["received"]["HOST_HEARTBEAT"] <= sent["HostHeartbeat"] == host["heartbeats_sent"]
    assert sent.total() == service["frames_sent"]
    accounts = account(result["counters"], told)
    assert accounts["setpoints"]["unaccounted"] == 0
    assert accounts["feedback"]["delivered"] == host["samples"]
    assert host["setpoints_sent"] >= 0.25 * 2500  # overruns skip ticks; most are there even on a busy machine

    assert told["drive"]["state"] == "DISABLED"
    assert told["drive"]["faults"] == 0
    replayed = start("replay", out / "run.mcap").end()
    assert (replayed.code, replayed.err) == (0, "")
    assert "all identical" in replayed.out
    assert f"{len(recording.references)} references from {len(recording.samples)} samples" in replayed.out


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signal_ends_a_run_clean(
    drive: DriveFixture, run: RunFixture, pty_wire: Any, tmp_path: Path, operational: Wait, number: int
) -> None:
    out = tmp_path / "out"
    other = drive(pty_wire)
    service = run(pty_wire, out)
    operational(service, out)
    ended = service.end(number)
    told = other.end(signal.SIGTERM).told
    assert (ended.code, ended.err) == (0, "")
    assert ended.out.startswith("stopped on request")
    result = result_of(out)
    assert (result["reason"], result["drive_disabled"]) == ("stop_requested", True)
    recording = read_recording(out / "run.mcap")
    check_whole(recording, "stop_requested")
    assert recording.samples["state"][-1] == DriveState.DISABLED
    assert result["counters"]["host"]["samples"] == len(recording.samples)
    assert (told["drive"]["state"], told["drive"]["faults"]) == ("DISABLED", 0)


def test_signal_while_nobody_answers_ends_a_run(
    run: RunFixture, drive: DriveFixture, pty_wire: Any, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    other = drive(pty_wire)
    other.signal(signal.SIGSTOP)
    ended = run(pty_wire, out).end()
    other.signal(signal.SIGCONT)
    assert ended.code == 2
    assert ended.err.startswith("hil-forceps: no drive answered: no frame was received")
    assert ended.err.count("\n") == 3
    assert result_of(out)["reason"] == "no_drive"


def test_killed_run_leaves_a_faulted_drive_and_a_readable_recording(
    drive: DriveFixture, run: RunFixture, pty_wire: Any, tmp_path: Path, operational: Wait, start: Any
) -> None:
    out = tmp_path / "out"
    other = drive(pty_wire)
    service = run(pty_wire, out)
    operational(service, out)
    assert service.end(signal.SIGKILL).code == -signal.SIGKILL
    second = run(pty_wire, tmp_path / "second", "--duration", "0.3").end()
    assert second.code == 2
    assert second.err.startswith(
        "hil-forceps: the drive has a latched fault: WATCHDOG (watchdog: no fresh reference in time); "
        "reset it with --reset-fault\n"
    )
    third = run(pty_wire, tmp_path / "third", "--duration", "0.3", "--reset-fault").end()
    assert (third.code, third.err) == (0, "")
    told = other.end(signal.SIGTERM).told
    assert (told["drive"]["state"], told["drive"]["faults"]) == ("DISABLED", 1)
    recording = read_recording(out / "run.mcap")
    assert recording.result == {}
    assert len(recording.samples) > 100
    assert recording.samples["state"][-1] == DriveState.OPERATIONAL
    (note,) = recording.notes
    assert note.startswith("recording is cut off or damaged at byte ")
    replayed = start("replay", out / "run.mcap").end()
    assert replayed.code == 1
    assert "incomplete: " in replayed.out
    assert "all identical" in replayed.out
    assert "cut off" in replayed.err


def test_killed_drive_ends_a_run_with_a_line(
    drive: DriveFixture, run: RunFixture, wire: Any, tmp_path: Path, operational: Wait
) -> None:
    out = tmp_path / "out"
    other = drive(wire)
    service = run(wire, out)
    operational(service, out)
    other.end(signal.SIGKILL)
    ended = service.end()
    assert ended.code == 2
    assert ended.err.count("\n") == 3
    assert ended.err.startswith("hil-forceps: the ")
    assert any(words in ended.err for words in ("the drive sent no more samples", "the bus failed"))
    result = result_of(out)
    assert result["reason"] in ("drive_lost", "bus_down")
    assert result["drive_disabled"] is False
    check_whole(read_recording(out / "run.mcap"), result["reason"])
    fault = json.loads((out / "fault.json").read_text())
    assert fault["reason"] == result["reason"]
    assert len(fault["samples"]["rows"]) > 10
    assert len(fault["frames"]) > 10


def test_drive_that_hangs_and_comes_back(
    drive: DriveFixture, run: RunFixture, pty_wire: Any, tmp_path: Path, operational: Wait
) -> None:
    out = tmp_path / "out"
    other = drive(pty_wire)
    service = run(pty_wire, out)
    operational(service, out)
    other.signal(signal.SIGSTOP)
    ended = service.end()
    assert ended.code == 2
    assert "the drive sent no more samples" in ended.err
    assert result_of(out)["reason"] == "drive_lost"
    other.signal(signal.SIGCONT)
    again = run(pty_wire, tmp_path / "again", "--duration", "0.5", "--reset-fault").end()
    assert (again.code, again.err) == (0, "")
    told = other.end(signal.SIGTERM).told
    assert told["slips"] >= 1
    assert told["drive"]["state"] == "DISABLED"


def test_second_run_meets_the_same_experiment(
    drive: DriveFixture, run: RunFixture, pty_wire: Any, tmp_path: Path
) -> None:
    other = drive(pty_wire)
    starts = []
    for name in ("first", "second"):
        ended = run(pty_wire, tmp_path / name, "--duration", "1", "--algorithm", "improved").end()
        assert (ended.code, ended.err) == (0, "")
        recording = read_recording(tmp_path / name / "run.mcap")
        check_whole(recording, "completed")
        rows = np.flatnonzero(recording.samples["state"] == DriveState.OPERATIONAL)
        stamps = recording.samples["stamp_ns"][rows]
        assert 0.99 <= (stamps[-1] - stamps[0]) * 1e-9 <= 1.2
        starts.append(stamps[0])
        trajectory = recording.references["trajectory_ns"]
        assert trajectory.max() <= 1.2e9
    assert starts[1] - starts[0] > 1_000_000_000
    told = other.end(signal.SIGINT).told
    assert (told["drive"]["state"], told["drive"]["faults"]) == ("DISABLED", 0)
