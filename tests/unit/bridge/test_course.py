"""What a run says of the drive at its end, with a drive that says what it is told to."""

from typing import Any, cast

import pytest

from firmware_protocol.messages import DriveState
from firmware_protocol.states import HostPhase
from hil_forceps.bridge.course import Course
from hil_forceps.bridge.results import ServiceConfig, Stage, StopReason
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
