"""The suite for makers' drives: it looks first, asks for little, and leaves no torque behind."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.conformance.findings import Disturbed, Inconclusive
from firmware_protocol.conformance.port import REAL
from firmware_protocol.conformance.suite import Verdict
from firmware_protocol.frames import Frame
from firmware_protocol.scales import ANGLE_LSB_RAD
from hil_forceps.bridge.drive_conformance.bounds import MAX_STEP_RAD, narrowed
from hil_forceps.bridge.drive_conformance.catalogue import PROMISES
from hil_forceps.bridge.drive_conformance.loop import Stopped
from hil_forceps.bridge.drive_conformance.suite import Suite
from hil_forceps.drives.registry import PROFILES, machine_for
from hil_forceps.rig import Rig
from tests.conformance.makers.bench import CONFIGS, drive_of, rig_of, suite_for
from tests.conformance.makers.table import Broken, leads, measures, wrap


def limited(rig: Rig, **limits: float) -> Rig:
    return rig.model_copy(update={"limits": rig.limits.model_copy(update=limits)})


@contextmanager
def odrive(peer: Any = None, **limits: float) -> Iterator[tuple[Suite, Any]]:
    """Yield the suite in front of an ODrive, and that."""
    rig = limited(rig_of("odrive"), **limits)
    peer = drive_of(rig) if peer is None else peer
    with suite_for(rig, {"nodes": [peer]}) as suite:
        yield suite, peer


@pytest.mark.parametrize("profile", sorted(PROFILES))
def test_no_reference_goes_further_than_a_step_or_beyond_the_limits(profile: str) -> None:
    rig = limited(rig_of(profile), position_max_rad=1.11)
    machine: Any = machine_for(rig)
    asked: list[tuple[float, float]] = []
    setpoint = machine.setpoint
    with suite_for(rig, {"rig": str(CONFIGS / f"{profile}.yaml"), "simulation": 0}, machine) as suite:

        def watched(raw: int) -> Frame | None:
            asked.append((raw * ANGLE_LSB_RAD, suite.session.home_rad))
            frame: Frame | None = setpoint(raw)
            return frame

        machine.setpoint = watched
        suite.open()
        results = suite.run(PROMISES)
        suite.close()
    assert not [r.evidence for r in results if r.verdict is Verdict.FAIL]
    assert len(asked) > 1000
    slack = 1.0e-6  # of the wire's unit
    assert max(abs(reference - home) for reference, home in asked) <= MAX_STEP_RAD + slack
    assert max(abs(reference - home) for reference, home in asked) > 0.99 * MAX_STEP_RAD
    assert max(reference for reference, _ in asked) <= 1.11 + slack


@pytest.mark.parametrize(
    ("limits", "told"),
    [
        ({"position_max_rad": 1.05}, "the motor is at 1.099 rad, `limits:` are -0.5 to 1.05; move it within"),
        ({"position_min_rad": 1.09, "position_max_rad": 1.11}, "no room for a step of 1 deg"),
    ],
)
def test_a_drive_that_is_in_no_place_to_be_judged(limits: dict[str, float], told: str) -> None:
    with odrive(**limits) as (suite, _), pytest.raises(Inconclusive, match=r"rad") as reason:
        suite.open()
    assert told in str(reason.value)


def test_without_motion_no_room_is_needed_and_nothing_moves() -> None:
    with odrive(position_min_rad=1.09, position_max_rad=1.11) as (suite, peer):
        suite.allow_motion = False
        suite.open()
        results = suite.run(PROMISES)
        suite.close()
        assert peer.modes == (0, 0)  # nothing was ever asked for
    assert {r.verdict for r in results} == {Verdict.PASS, Verdict.NOT_RUN}
    assert [r.requirement.number for r in results if r.verdict is Verdict.PASS] == [10, 20, 21, 22, 30]


def test_a_fault_from_before_is_told_with_the_remedy() -> None:
    with odrive() as (suite, peer):
        peer.trip()
        with pytest.raises(Inconclusive, match=r"missing input.*--reset-fault"):
            suite.open()


def test_nobody_there() -> None:
    rig = rig_of("odrive")
    with (
        suite_for(rig, {"nodes": []}) as suite,
        pytest.raises(Inconclusive, match="no drive answered: no frame was received"),
    ):
        suite.open()


def test_a_refused_drive_fails_by_its_refusal_and_gets_no_torque() -> None:
    with odrive() as (suite, peer):
        peer._iq_every = 0
        suite.open()
        first, *others = suite.run(PROMISES)
        suite.close()
        assert peer.modes == (0, 0)
    assert first.verdict is Verdict.FAIL
    assert "sends heartbeats, but no Iq" in first.evidence
    assert {r.verdict for r in others} == {Verdict.INCONCLUSIVE}


def test_a_motor_that_is_pushed_without_torque_is_told_before_anything_is_judged() -> None:
    with odrive() as (suite, peer):
        measures(Broken(suite.session.rig, peer, None), _drifting())
        with pytest.raises(Inconclusive, match="does not come to rest without torque; take the load off the jaw"):
            suite.open()


def _drifting() -> Any:
    drifted = [0]

    def drift(theta: int, current: int, _has_torque: bool) -> tuple[int, int]:
        drifted[0] += 300  # 36 deg/s
        return theta + drifted[0], current

    return drift


def test_what_pushes_the_motor_later_ends_the_run() -> None:
    with odrive() as (suite, peer):
        suite.open()
        measures(Broken(suite.session.rig, peer, None), _drifting())
        with pytest.raises(Disturbed, match="an external torque moved the motor"):
            suite.run(PROMISES)
        suite.close()
        assert peer.state == 1


def test_a_drive_that_goes_against_gets_no_more_torque() -> None:
    enabled = [0]
    with odrive() as (suite, peer):
        leads(Broken(suite.session.rig, peer, None), lambda reference, start, _since_ns: 2 * start - reference)
        suite.open()
        results = {r.requirement.number: r for r in suite.run((40, 41, 50))}
        assert results[50].verdict is Verdict.FAIL
        assert "motor_driver.encoder_rev_per_pulley_rev" in results[50].evidence
        request = peer._request
        peer._request = lambda state: (enabled.__setitem__(0, enabled[0] + (state == 8)), request(state))
        later = suite.run(PROMISES)
        suite.close()
        assert peer.state == 1
    assert enabled[0] == 0
    assert {r.verdict for r in later if r.requirement.number > 50} == {Verdict.NOT_RUN}
    moved = suite.session.extremes
    assert moved.theta_high_rad - moved.theta_low_rad < MAX_STEP_RAD


def test_a_runaway_is_stopped_at_two_degrees() -> None:
    with odrive() as (suite, peer):
        leads(Broken(suite.session.rig, peer, None), lambda _reference, start, since_ns: start + since_ns // 1000)
        suite.open()
        results = suite.run(PROMISES)
        suite.close()
        assert peer.state == 1
    assert "torque was taken off" in next(r.evidence for r in results if r.verdict is Verdict.FAIL)
    moved = suite.session.extremes
    assert MAX_STEP_RAD < moved.theta_high_rad - moved.theta_low_rad < 3.0 * MAX_STEP_RAD


def test_a_motor_that_runs_off_later_is_stopped_too() -> None:
    with odrive() as (suite, peer):
        leads(
            Broken(suite.session.rig, peer, None),
            lambda reference, start, since_ns: start + 200_000 if since_ns > 500_000_000 else reference,
        )
        errors: list[int] = []

        def failed(fail: Callable[[int], None], error: int) -> None:
            errors.append(error)
            fail(error)

        wrap(peer, "_fail", failed)
        suite.open()
        results = [r for r in suite.run(PROMISES) if r.verdict is Verdict.FAIL]
        suite.close()
        assert errors == [0x2000000]  # the emergency stop
    assert [r.requirement.number for r in results] == [41]
    assert "no reference is further than 1 deg; torque was taken off" in results[0].evidence


@given(st.floats(-3.0, 3.0), st.floats(0.0, 2.0), st.floats(0.0, 2.0), st.floats(1e-3, 1e3), st.floats(1e-2, 1e6))
def test_the_suites_gate_is_never_wider_than_the_rigs(
    home: float, below: float, above: float, speed: float, acceleration: float
) -> None:
    rig = limited(
        rig_of("odrive"),
        position_min_rad=home - below,
        position_max_rad=home + above,
        speed_max_rad_per_s=speed,
        acceleration_max_rad_per_s2=acceleration,
    )
    mine, theirs = narrowed(rig.limits, home), rig.limits
    assert theirs.position_min_rad <= mine.position_min_rad <= mine.position_max_rad <= theirs.position_max_rad
    assert home - MAX_STEP_RAD <= mine.position_min_rad <= mine.position_max_rad <= home + MAX_STEP_RAD
    assert mine.speed_max_rad_per_s <= theirs.speed_max_rad_per_s
    assert mine.acceleration_max_rad_per_s2 <= theirs.acceleration_max_rad_per_s2
    assert mine.max_sample_age_s == theirs.max_sample_age_s


def test_a_wish_to_stop_ends_without_torque_and_without_a_fault() -> None:
    with odrive() as (suite, peer):
        suite.open()
        suite.session.stop_requested = lambda: peer.state == 8
        with pytest.raises(Stopped):
            suite.run(PROMISES)
        assert peer.state == 8
        suite.close()
        assert (peer.state, peer.error) == (1, 0)


def test_a_mistake_of_this_program_sends_the_emergency_stop() -> None:
    with odrive() as (suite, peer):
        suite.open()

        def fails() -> bool:
            if peer.state == 8:
                raise ZeroDivisionError
            return False

        suite.session.stop_requested = fails
        with pytest.raises(ZeroDivisionError):
            suite.run(PROMISES)
        suite.close()
        assert (peer.state, peer.error) == (1, 0x2000000)


def test_a_drive_whose_line_is_cut_is_lost_and_not_judged() -> None:
    with odrive() as (suite, peer):
        suite.open()
        send = peer._send
        peer._send = lambda command, data: None if peer.state == 8 else send(command, data)
        results = {r.requirement.number: r for r in suite.run(PROMISES)}
        assert peer.state == 1  # its watchdog
    assert results[40].verdict is Verdict.FAIL
    assert Verdict.PASS not in {r.verdict for n, r in results.items() if n > 40}


class StandingLine:
    """A line in real time, whose host stands still now and then, over one in virtual time."""

    virtual_time = False

    def __init__(self, line: Any, stands_ns: int) -> None:
        self._line, self._stands_ns, self._waits = line, stands_ns, 0
        self.send, self.receive, self.now_ns = line.send, line.receive, line.now_ns

    def wait_until(self, time_ns: int) -> None:
        self._waits += 1
        self._line.wait_until(time_ns + self._stands_ns * (self._waits % 50 == 0))


@pytest.mark.parametrize("stands_ms", [0, 8])
def test_a_host_that_stands_still_fails_nobody_but_a_motor_that_goes_on_does(stands_ms: int) -> None:
    with odrive() as (suite, peer):
        suite.session.line = StandingLine(suite.session.line, stands_ms * 1_000_000)
        suite.session.margins = REAL
        peer._encoder_every *= 2  # at half the rate
        peer._iq_every *= 2
        peer._watchdog_ns = 0
        suite.open()
        results = {r.requirement.number: r for r in suite.run((20, 60))}
        suite.close()
    assert results[20].verdict is (Verdict.INCONCLUSIVE if stands_ms else Verdict.FAIL)
    assert results[20].attempts == (REAL.attempts if stands_ms else 1)
    assert ("was blocked" in results[20].evidence) is bool(stands_ms)
    assert results[60].verdict is Verdict.FAIL
    assert "the motor still has torque" in results[60].evidence
