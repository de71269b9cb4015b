"""The simulated mini cheetah drive by itself: what each variant answers, keeps, and does behind its time-out."""

import math
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from firmware_protocol.frames import Frame
from hil_forceps.drives.mit import messages as wire
from hil_forceps.drives.mit.machine import Mit
from hil_forceps.drives.mit.messages import Codes, Special
from hil_forceps.drives.registry import machine_for
from hil_forceps.rig.errors import UserError
from tests.unit.drives.mit.simulated import MS, NODE, RIG, RIG_FILE, VARIANTS, run
from virtual_bus.drives.mit import COMMUNICATION_LOST, DISABLED, ENABLED, SimulatedMit
from virtual_bus.plant.load import paper_load

EXIT, ENTER, SET_ZERO = (wire.special(NODE, which) for which in (Special.EXIT, Special.ENTER, Special.SET_ZERO))


def mit(variant: str = "bgkatz", **change: Any) -> SimulatedMit:
    changes = {f"motor_driver.{key}": value for key, value in change.items()}
    rig = RIG.with_changes({"motor_driver.mit_variant": variant, "motor_driver.reply_id": None, **changes})
    return SimulatedMit(rig, paper_load(0))


def command(kp: int = 0, kd: int = 0, position: int = 32_768) -> Frame:
    return wire.command(NODE, Codes(position, wire.ZERO_SPEED_CODE, kp, kd, wire.ZERO_TORQUE_CODE))


def angle_rad(drive: SimulatedMit, at_ms: int) -> float:
    drive.wake(at_ms * MS)
    return float(drive._forceps.truth(at_ms * MS).theta_m_rad)


@pytest.mark.parametrize("variant", VARIANTS)
def test_it_says_nothing_by_itself_and_answers_once(variant: str) -> None:
    drive = mit(variant)
    drive.wake(100 * MS)
    assert drive.take_outbox() == []
    for n, frame in enumerate((EXIT, ENTER, command(), EXIT)):
        drive.receive(frame, (101 + n) * MS)
        assert len(drive.take_outbox()) == 1


def test_a_cubemars_does_not_answer_commands_outside_of_motor_mode() -> None:
    drive = mit("cubemars")
    drive.receive(command(kp=400), MS)
    assert (drive.take_outbox(), drive.command.kp) == ([], 0.0)


def test_a_bgkatz_keeps_a_command_from_outside_of_motor_mode_and_chases_it() -> None:
    drive = mit()
    before_rad = angle_rad(drive, 1)
    drive.receive(command(kp=800, kd=80), 2 * MS)  # towards 0, and the jaw is at 1.1 rad
    drive.receive(ENTER, 3 * MS)
    assert before_rad - angle_rad(drive, 20) > 0.3


def test_exit_is_the_end_of_what_a_bgkatz_keeps() -> None:
    drive = mit()
    before_rad = angle_rad(drive, 1)
    for n, frame in enumerate((command(kp=800, kd=80), EXIT, ENTER)):
        drive.receive(frame, (2 + n) * MS)
    assert abs(before_rad - angle_rad(drive, 20)) < 1e-3


def test_behind_the_time_out_a_bgkatz_lets_go_and_stays_in_motor_mode() -> None:
    drive = mit()
    drive.receive(ENTER, MS)
    drive.receive(command(kp=800), 2 * MS)
    drive.wake(26 * MS)
    assert drive.command.kp > 0.0
    drive.receive(ENTER, 26 * MS + 1)  # feeds no time-out
    drive.wake(30 * MS)
    assert (drive.command.kp, drive.enabled, drive.reference_rad()) == (0.0, True, None)
    drive.receive(command(kp=800), 31 * MS)
    assert drive.reference_rad() is not None


def test_the_time_out_of_a_damiao_is_a_fault_until_it_is_cleared() -> None:
    drive = mit("damiao")
    drive.receive(ENTER, MS)
    drive.receive(command(kp=800), 2 * MS)
    drive.wake(30 * MS)
    assert (drive.enabled, drive.fault) == (False, COMMUNICATION_LOST)
    drive.receive(ENTER, 31 * MS)
    assert not drive.enabled
    drive.receive(wire.special(NODE, Special.CLEAR_ERRORS), 32 * MS)
    drive.receive(ENTER, 33 * MS)
    drive.receive(EXIT, 34 * MS)
    assert [frame.data[0] >> 4 for frame in drive.take_outbox()] == [
        DISABLED, ENABLED, COMMUNICATION_LOST, COMMUNICATION_LOST, DISABLED, ENABLED,
    ]  # fmt: skip


def test_nothing_ends_the_last_command_of_a_cubemars() -> None:
    drive = mit("cubemars")
    drive.receive(ENTER, MS)
    drive.receive(command(kp=800), 2 * MS)
    drive.wake(1_000 * MS)
    assert drive.reference_rad() is not None


def test_a_bgkatzs_filter_takes_frames_of_other_ids() -> None:
    drive = mit()
    drive.receive(Frame(NODE + 0x80, ENTER.data), MS)  # CANopen's SYNC and emergencies are there
    assert drive.enabled
    other = mit("damiao")
    other.receive(Frame(NODE + 0x80, ENTER.data), MS)
    assert not other.enabled


def test_a_bgkatz_wraps_its_angle_and_others_hold_it() -> None:
    for variant, wraps in (("bgkatz", True), ("damiao", False), ("cubemars", False)):
        drive = mit(variant, encoder_zero_rev=0.5)  # 3.14 and 1.1 rad of 3.2
        drive.receive(EXIT, MS)
        (frame,) = drive.take_outbox()
        reply = wire.parse_reply(frame.data)
        assert reply is not None
        position_rad = wire.measured(reply.position, 3.2, wire.MAX_POSITION_CODE)
        true_rad = math.pi + angle_rad(drive, 1)
        assert position_rad == pytest.approx(true_rad - 6.4 if wraps else 3.2, abs=1e-3)


def test_a_bgkatz_tells_the_largest_current_since_the_last_command() -> None:
    told = {}
    for variant in ("bgkatz", "damiao"):
        drive = mit(variant)
        drive.receive(ENTER, MS)
        drive.receive(command(kp=0), 2 * MS)
        drive._current_A = drive._largest_A = 0.0
        for n in range(200):
            drive.receive(command(kp=0), (3 + n) * MS)
        replies = [wire.parse_reply(frame.data) for frame in drive.take_outbox()]
        torques = [wire.measured(reply.torque, 1.0, wire.MAX_CODE) for reply in replies[10:] if reply]
        told[variant] = float(np.mean(torques))
    assert abs(told["damiao"]) < 1e-3
    assert told["bgkatz"] > 1e-3  # ten readings of a noise of 1 mA: the largest is 1.5 above the mean


def test_zero_is_set_outside_of_motor_mode_alone() -> None:
    drive = mit()
    drive.receive(ENTER, MS)
    drive.receive(SET_ZERO, 2 * MS)
    drive.receive(EXIT, 3 * MS)
    drive.receive(SET_ZERO, 4 * MS)
    drive.receive(EXIT, 5 * MS)
    positions = [reply.position for frame in drive.take_outbox() if (reply := wire.parse_reply(frame.data))]
    assert positions[2] == positions[0]
    assert abs(positions[4] - wire.MAX_POSITION_CODE / 2) < 2


def test_the_gains_of_the_frame_are_those_of_the_loop() -> None:
    drive = mit()
    theta_rad = angle_rad(drive, 1)
    away = wire.code_of(theta_rad - 0.05, -3.2, 3.2, wire.MAX_POSITION_CODE)
    drive.receive(ENTER, MS + 1)
    currents = []
    for kp in (100, 200):
        drive.receive(command(kp=kp, position=away), 2 * MS)
        currents.append(drive._wanted_A())
    kp_N_m_per_rad = 100 * 0.5 / wire.MAX_CODE
    expected_A = -kp_N_m_per_rad * 0.05 / 0.0135
    assert currents[0] == pytest.approx(expected_A, rel=0.02)
    assert currents[1] == pytest.approx(2.0 * expected_A, rel=0.02)


@pytest.mark.parametrize("current_range_A", [None, 1.5])
@pytest.mark.parametrize("ratio", [1.0, 2.0, -0.5])
def test_a_current_comes_back_as_itself_whatever_the_gear(ratio: float, current_range_A: float | None) -> None:
    change = {
        "encoder_rev_per_pulley_rev": ratio,
        "feedback_current_range_A": current_range_A,
        "position_range_rad": 6.4,
    }
    drive = mit("damiao", **change)
    rig = RIG.with_changes(
        {"motor_driver.mit_variant": "damiao", **{f"motor_driver.{key}": value for key, value in change.items()}}
    )
    host = cast(Mit, machine_for(rig))
    drive._current_A = 0.25
    drive._answer()
    reply = wire.parse_reply(drive.take_outbox()[0].data)
    assert reply is not None
    current_A = wire.measured(reply.torque, host.config.current_range_A, wire.MAX_CODE)
    assert current_A == pytest.approx(0.25, abs=2.0 * abs(host.config.current_range_A) / wire.MAX_CODE)


def test_a_rig_without_ranges_has_no_simulated_drive() -> None:
    with pytest.raises(UserError, match="ranges are missing"):
        mit(torque_range_N_m=None)
    with pytest.raises(UserError, match="with a mit_variant"):
        SimulatedMit(RIG.with_changes({"motor_driver.mit_variant": None}), paper_load(0))


def test_a_rig_with_effects_has_one(tmp_path: Path) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text(
        RIG_FILE.read_text() + "\neffects:\n  stribeck_friction:\n    rise_N_m: 1.0e-4\n    speed_rad_per_s: 1.0\n"
    )
    code, result = run(tmp_path, rig)
    assert (code, result["reason"]) == (0, "completed")
