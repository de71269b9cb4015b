"""What the suite does with its drive, with a host that stands still, and with what it found."""

import json
import xml.etree.ElementTree as ET
from collections.abc import Sequence

import pytest

from firmware_protocol.conformance.catalogue import REQUIREMENTS
from firmware_protocol.conformance.findings import Disturbed, Inconclusive
from firmware_protocol.conformance.port import MS, REAL, VIRTUAL
from firmware_protocol.conformance.report import certificate, is_well, junit
from firmware_protocol.conformance.suite import NEEDS_MOTION, CheckResult, Result, Suite, Verdict, discover
from firmware_protocol.drive.machine import DriveMachine
from firmware_protocol.frames import Frame
from firmware_protocol.messages import DriveState
from firmware_protocol.states import DriveEvent
from tests.conformance.broken.faults_and_parameters import answers_twice
from tests.conformance.devices import ANGLE, NODE, SERIAL_NUMBER, Device, DirectPort


class Watched(Device):
    """Remembers the states it was in."""

    def __init__(self) -> None:
        super().__init__(watchdog_timeout_us=30_000, max_step_raw=5_000)
        self.states: set[DriveState] = set()

    def sample(self, now_us: int) -> list[Frame]:
        self.states.add(self.machine.state)
        return super().sample(now_us)


class RealPort(DirectPort):
    """Says that its time is real; stands still for `stall_ns` once each `every_ns`."""

    virtual_time = False

    def __init__(self, device: Device, stall_ns: int = 0, every_ns: int = MS, times: int = 1 << 30) -> None:
        super().__init__(device)
        self.stall_ns, self.every_ns, self.left = stall_ns, every_ns, times
        self.next_stall_ns = every_ns

    def wait_until(self, time_ns: int) -> None:
        if self.stall_ns and self.left and time_ns >= self.next_stall_ns:
            self.next_stall_ns = time_ns + self.every_ns
            self.left -= 1
            time_ns += self.stall_ns
        super().wait_until(time_ns)


def opened(port: DirectPort, allow_motion: bool = True) -> Suite:
    suite = Suite(port, NODE, VIRTUAL if port.virtual_time else REAL, allow_motion)
    suite.open()
    return suite


def by_verdict(results: Sequence[Result], verdict: Verdict) -> set[int]:
    return {r.requirement.number for r in results if r.verdict is verdict}


def test_the_drive_is_left_as_it_was_found() -> None:
    device = Watched()
    before = dict(device.machine._values._values)
    suite = opened(DirectPort(device))
    assert suite.session.originals[0x0201] == 30_000
    results = suite.run(REQUIREMENTS)
    suite.close()
    assert not by_verdict(results, Verdict.FAIL)
    assert device.machine.state is DriveState.DISABLED
    assert device.machine.node == NODE
    after = device.machine._values._values
    assert {k: v for k, v in after.items() if k < 0x0401} == {k: v for k, v in before.items() if k < 0x0401}
    assert DriveState.OPERATIONAL in device.states


def test_no_torque_without_leave() -> None:
    device = Watched()
    suite = opened(DirectPort(device), allow_motion=False)
    results = suite.run(REQUIREMENTS)
    assert device.states == {DriveState.DISABLED, DriveState.ARMED, DriveState.FAULT}
    assert device.angle == ANGLE
    unmoved = {r.requirement.number for r in results if r.evidence == NEEDS_MOTION}
    assert {91, 96, 110, 117, 120, 124} <= unmoved
    assert unmoved <= by_verdict(results, Verdict.NOT_RUN)
    assert is_well(results, ())
    assert not is_well(results, (120,))


def test_a_host_that_stands_still_all_the_time_fails_nobody() -> None:
    suite = opened(RealPort(Device(), stall_ns=40 * MS, every_ns=60 * MS))
    results = suite.run((32, 81, 82, 84, 98, 110, 120, 121, 159))
    assert not by_verdict(results, Verdict.FAIL)
    assert {81, 84, 98, 120} <= by_verdict(results, Verdict.INCONCLUSIVE)
    assert not is_well(results, ())
    assert "this host was blocked in each of 5 attempts" in results[1].evidence


def test_a_host_that_stood_still_once_tries_again() -> None:
    device = Device()
    suite = opened(RealPort(device))
    suite.session.port = port = RealPort(device, 60 * MS, 100 * MS, times=1)
    port.time_ns = device.next_ns
    port.next_stall_ns = port.time_ns + 60 * MS
    (result,) = suite.run((120,))
    assert result.verdict is Verdict.PASS
    assert result.checks[0].attempts == 2


def test_a_drive_that_fails_although_the_host_was_in_time_fails_after_as_many_tries() -> None:
    device = Device()
    answers_twice(device)
    (result,) = opened(RealPort(device)).run((150,))
    assert result.verdict is Verdict.FAIL
    assert result.checks[0].attempts == REAL.attempts


class NeverResets(Device):
    """Stays in FAULT for good."""

    class Machine(DriveMachine):
        def _fire(self, event: DriveEvent, reason: object = None) -> None:
            if event is not DriveEvent.RESET:
                super()._fire(event, reason)  # type: ignore[arg-type]

    machine_type = Machine


def test_a_drive_that_can_not_be_brought_back_ends_the_run() -> None:
    suite = opened(DirectPort(NeverResets()))
    results = suite.run((92, 94, 95, 99))
    assert suite.lost_drive.startswith("after HFP-094")
    assert by_verdict(results, Verdict.PASS) == {92}
    assert {95, 99} <= by_verdict(results, Verdict.INCONCLUSIVE)
    with pytest.raises(Inconclusive):
        suite.close()


class Moved(Device):
    """Something moves the motor, or the drive itself does with a current, where it has no torque."""

    current_without_torque = 0

    def move(self) -> None:
        super().move()
        if self.goal() is None:
            self.angle += 20.0
            self.current = self.current_without_torque


class MovedByItself(Moved):
    current_without_torque = 500


class Mute(Device):
    """Measures nothing."""

    def sample(self, now_us: int) -> list[Frame]:  # noqa: ARG002
        return []


def test_a_motor_that_something_moves_is_not_judged() -> None:
    with pytest.raises(Inconclusive, match="does not come to rest without torque; take the load off the jaw"):
        opened(DirectPort(Moved()))


@pytest.mark.parametrize(("device", "number"), [(MovedByItself(), 91), (Mute(), 70)])
def test_what_the_drive_does_wrong_is_a_verdict_all_the_same(device: Device, number: int) -> None:
    (result,) = opened(DirectPort(device)).run((number,))
    assert result.verdict is not Verdict.PASS


class PushedLater(Device):
    """A load begins to push once the drive has given torque, and goes on where it gives none."""

    pushed = False

    def move(self) -> None:
        super().move()
        self.pushed |= self.goal() is not None
        if self.pushed and self.goal() is None:
            self.angle += 2000.0


class PushesItself(Device):
    """Goes where it likes with torque, and stays there."""

    def move(self) -> None:
        super().move()
        if self.goal() is not None:
            self.angle += 30000.0


def test_a_load_that_pushes_the_motor_beyond_its_limits_ends_the_run() -> None:
    suite = opened(DirectPort(PushedLater(theta_max_raw=ANGLE + (1 << 19))))
    with pytest.raises(Disturbed, match="an external torque moved the motor"):
        suite.run(REQUIREMENTS)


def test_a_drive_that_goes_beyond_its_limits_by_itself_is_judged() -> None:
    suite = opened(DirectPort(PushesItself(theta_max_raw=ANGLE + (1 << 19))))
    assert by_verdict(suite.run(REQUIREMENTS), Verdict.FAIL)


@pytest.mark.parametrize("allow_motion", [False, True])
def test_a_motor_beyond_its_limits_is_not_judged(allow_motion: bool) -> None:
    device = Device(theta_min_raw=ANGLE + 1)
    with pytest.raises(Inconclusive, match="move it within, or change theta_min_raw"):
        opened(DirectPort(device), allow_motion)


def test_a_motor_without_room_is_judged_where_it_is_not_to_move() -> None:
    def cramped() -> Device:
        return Device(theta_min_raw=ANGLE - 1000, theta_max_raw=ANGLE + 1000)

    opened(DirectPort(cramped()), allow_motion=False)
    with pytest.raises(Inconclusive, match="no room for the motion of 262144"):
        opened(DirectPort(cramped()))


def test_drives_are_found_by_discover() -> None:
    (identity,) = discover(DirectPort(Device()), MS)
    assert (identity.node, identity.serial_number) == (NODE, SERIAL_NUMBER)
    silent = DirectPort(Device())
    silent.device.receive = lambda *_: []  # type: ignore[method-assign]
    assert discover(silent, MS) == []
    with pytest.raises(Inconclusive, match="protocol_major could not be read"):
        opened(silent)


def certified() -> tuple[str, list[Result]]:
    suite = opened(DirectPort(Device()))
    results = suite.run((1, 23, 84, 92, 120, 150))
    return json.dumps(certificate(suite, "direct", results), indent=1), results


def test_certificate_is_the_same_each_time_and_says_what_was_measured() -> None:
    text, _ = certified()
    assert text == certified()[0]
    written = json.loads(text)
    assert written["device"]["serial_number"] == f"{SERIAL_NUMBER:012x}"
    assert written["device"]["parameters"]["watchdog_timeout_us"] == 20_000
    assert written["time"] == "virtual"
    assert written["margins"]["line_ns"] == MS
    assert written["verdicts"] == {"pass": 4, "fail": 0, "inconclusive": 0, "not run": 2}
    rows = {row["id"]: row for row in written["requirements"]}
    watchdog = rows["HFP-120"]["checks"][0]["timings"]["watchdog of 20000 us"]
    assert watchdog["allowed_us"][0] <= watchdog["least_us"] <= watchdog["most_us"] <= watchdog["allowed_us"][1]
    assert rows["HFP-001"]["verdict"] == "not run"
    assert rows["HFP-150"]["checks"][0]["timings"]["PARAM_RESPONSE"]["count"] == 42


def test_junit_counts() -> None:
    _, results = certified()
    bad = results[3]._replace(verdict=Verdict.FAIL, evidence='<"&\x07>')
    open_end = results[4]._replace(verdict=Verdict.INCONCLUSIVE)
    root = ET.fromstring(junit([*results[:3], bad, open_end, results[5]], "a <line>"))
    assert root.attrib == {"name": "a <line>", "tests": "6", "failures": "1", "errors": "1", "skipped": "2"}
    failure = root.find("./testcase/failure")
    assert failure is not None
    assert failure.get("message") == '<"&?>'


@pytest.mark.parametrize(
    ("number", "verdict", "named", "well"),
    [
        (92, Verdict.PASS, False, True),
        (92, Verdict.FAIL, False, False),
        (92, Verdict.INCONCLUSIVE, False, False),
        (92, Verdict.NOT_RUN, False, True),
        (92, Verdict.NOT_RUN, True, False),
        (52, Verdict.FAIL, False, False),
        (52, Verdict.INCONCLUSIVE, False, True),
        (52, Verdict.INCONCLUSIVE, True, False),
    ],
)
def test_what_is_well(number: int, verdict: Verdict, named: bool, well: bool) -> None:
    result = Result(REQUIREMENTS[number], verdict, "", (CheckResult("x", verdict, "", 1, ()),), True)
    assert is_well([result], (number,) if named else ()) is well
