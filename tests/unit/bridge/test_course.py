"""What a run says of the drive at its end, with a drive that says what it is told to."""

from types import SimpleNamespace
from typing import Any, cast

import pytest

from firmware_protocol.messages import DriveState
from firmware_protocol.states import HostPhase
from hil_forceps.bridge.course import Course
from hil_forceps.bridge.pipeline import GATE_CODES
from hil_forceps.bridge.results import ServiceConfig, Stage, StopReason
from hil_forceps.control.gate import GateVerdict
from hil_forceps.drives.port import DriveMachine

MS = 1_000_000


class Drive:
    """As much of a `DriveMachine` as a course looks at."""

    refusal = ""

    def __init__(self) -> None:
        self.phase = HostPhase.IDENTIFYING
        self.drive_state: DriveState | None = None
        self.calls: list[str] = []

    def connect(self, now_ns: int) -> None:
        self.calls.append(f"connect {now_ns}")

    def enable(self) -> None:
        self.calls.append("enable")

    def disable(self) -> None:
        self.calls.append("disable")

    def fault_words(self) -> str:
        return "a fault"


def course_of(drive: Drive, is_stopped: bool = False) -> Course:
    nothing: Any = None  # no stage that is reached here asks for it
    course = Course(cast(DriveMachine, drive), nothing, ServiceConfig(duration_ns=MS), None, lambda: is_stopped)
    course.begin(0)
    return course


@pytest.mark.parametrize(
    ("said", "is_disabled"),
    [
        (None, True),  # nobody was asked for torque
        (DriveState.DISABLED, True),
        (DriveState.FAULT, True),
        (DriveState.ARMED, False),
        (DriveState.OPERATIONAL, False),
    ],
)
def test_before_torque_was_asked_for_the_drives_own_word_counts(said: DriveState | None, is_disabled: bool) -> None:
    drive = Drive()
    drive.drive_state = said
    course = course_of(drive, is_stopped=True)
    course.advance(MS)
    assert (course.stage, course.reason) == (Stage.ENDED, StopReason.STOP_REQUESTED)
    assert course.drive_disabled is is_disabled
    assert ("has torque" in course.message) is not is_disabled


def test_a_drive_that_is_gone_while_enabling_is_not_waited_for() -> None:
    drive = Drive()
    course = course_of(drive)
    drive.phase = HostPhase.READY
    course.advance(MS)
    assert course.stage is Stage.ENABLING
    drive.phase = HostPhase.DISCONNECTED
    course.advance(2 * MS)
    assert (course.stage, course.reason) == (Stage.STOPPING, StopReason.DRIVE_LOST)
    assert drive.calls == ["connect 0", "enable", "disable"]


@pytest.mark.parametrize(
    ("passed_stamp_ns", "denied_in_a_row", "reason", "words"),
    [
        (100 * MS, 0, StopReason.COMPLETED, "completed"),
        (80 * MS, 0, StopReason.COMPLETED, "completed"),
        (80 * MS - 1, 0, StopReason.REFERENCE_DENIED, "the last 20 ms of the run: samples were older than"),
        (60 * MS, 2, StopReason.REFERENCE_DENIED, "the last 40 ms of the run: the gate denied them: DENIED_GAP"),
    ],
)
def test_a_run_whose_motor_was_let_go_before_its_end_is_not_completed(
    passed_stamp_ns: int, denied_in_a_row: int, reason: StopReason, words: str
) -> None:
    pipeline: Any = SimpleNamespace(
        is_latched=False,
        denied_in_a_row=denied_in_a_row,
        newest=SimpleNamespace(stamp_ns=100 * MS),
        zero_ns=0,
        passed_stamp_ns=passed_stamp_ns,
        gate=SimpleNamespace(max_gap_ns=20 * MS),
        verdict=GATE_CODES[GateVerdict.DENIED_GAP],
    )
    drive = Drive()
    course = Course(cast(DriveMachine, drive), pipeline, ServiceConfig(duration_ns=100 * MS), None, lambda: False)
    course.begin(0)
    for phase in (HostPhase.READY, HostPhase.RUNNING):
        drive.phase = phase
        course.advance(MS)
    course.last_sample_ns = 101 * MS
    course.advance(101 * MS)
    assert (course.stage, course.reason) == (Stage.STOPPING, reason)
    assert words in course.message


@pytest.mark.parametrize(
    ("said", "words"),
    [(DriveState.OPERATIONAL, "for another program; end that program first"), (DriveState.ARMED, "0 samples received")],
)
def test_a_drive_that_another_program_drives_is_told_as_that(said: DriveState, words: str) -> None:
    drive, line = (
        Drive(),
        cast(Any, SimpleNamespace(counters={"samples": 0, "stale": 0, "passed": 0}, denied_in_a_row=0)),
    )
    course = Course(cast(DriveMachine, drive), line, ServiceConfig(duration_ns=MS), None, lambda: False)
    course.begin(0)
    drive.phase, drive.drive_state = HostPhase.READY, said
    course.advance(MS)
    drive.phase = HostPhase.ENABLING
    course.advance(MS + ServiceConfig(duration_ns=MS).enable_timeout_ns)
    assert course.reason is StopReason.ENABLE_FAILED
    assert words in course.message
