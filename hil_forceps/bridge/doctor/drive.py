"""The drive that answers, beside the rig."""

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

from firmware_protocol.messages import DriveState
from firmware_protocol.scales import ANGLE_LSB_PER_REV, ANGLE_LSB_RAD
from hil_forceps.bridge.doctor.check import Check, Verdict, unknown
from hil_forceps.bridge.links.adapters import Connection
from hil_forceps.drives.inquiry import Inquiry, Said
from hil_forceps.drives.profile import Found
from hil_forceps.drives.registry import PROFILES, sample_period_s
from hil_forceps.drives.scan import BusListener
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError

LISTEN_S: Final = 2.0  # the service's own time for a drive to show
POLL_NS: Final = 5_000_000
MAX_PERIOD_ERROR_SHARE: Final = 0.05  # of a period measured over 20 of it, each end a frame late at most
MAX_TORQUE_CONSTANT_ERROR_SHARE: Final = 0.01  # of K_t: 1 % of the torque that is estimated
_NOT_TOLD: Final = "the drive does not report it without being enabled"


class Heard(NamedTuple):
    """What came over the line: what each rig's drive said, None where it wasn't heard, and all who were there."""

    said: tuple[Said | None, ...]
    found: tuple[Found, ...]
    frames: int


def listen(connection: Connection, inquiries: Sequence[Inquiry | None], rigs: Sequence[Rig]) -> Heard:
    """Ask and listen until all have said what they say, or for `LISTEN_S`; the link stays open."""
    link, clock = connection.link, connection.clock
    serial = {rig.drive_profile for rig in rigs if rig.drive_profile != "native"}
    serial = {name for name in serial if PROFILES[name].link == "serial"}
    listener = BusListener(PROFILES[serial.pop()] if serial else None)
    asked = [inquiry for inquiry in inquiries if inquiry is not None]
    now_ns = clock.now_ns()
    end_ns = now_ns + round(LISTEN_S * 1e9)
    while now_ns < end_ns and not (asked and all(inquiry.is_complete() for inquiry in asked)):
        for inquiry in asked:
            for frame in inquiry.poll(now_ns):
                link.send(frame)
        clock.sleep_until_ns(min(now_ns + POLL_NS, end_ns))
        now_ns = clock.now_ns()
        for time_ns, frame in link.receive():
            listener.receive(frame)
            for inquiry in asked:
                inquiry.receive(frame, time_ns)
    said = tuple(None if inquiry is None else inquiry.said() for inquiry in inquiries)
    return Heard(said, tuple(listener.found()), listener.frames)


def checks(rig: Rig, said: Said | None, heard: Heard) -> Iterator[Check]:
    """Judge what a rig's drive said."""
    yield _answers(rig, said, heard)
    if said is None:
        return
    yield _version(said)
    yield _state(said)
    yield _fault(said)
    yield _counts(rig, said)
    yield _sample_period(rig, said)
    yield _current_limit(rig, said)
    yield _torque_constant(rig, said)
    yield _range(rig, said)
    yield _transport(rig, said)


def who_is_there(heard: Heard) -> Check:
    """Judge a line without a rig to compare."""
    name, what = "line.drives", "which drives are on the line, by listening"
    if heard.found:
        said = "; ".join(f"{each.profile} {each.node}: {each.says}" for each in heard.found)
        return Check(name, what, Verdict.OK, said, "", float(len(heard.found)), "drives")
    came = f"{heard.frames} frames were received, none of a known drive" if heard.frames else "no frame was received"
    remedy = "check power, wiring, termination, bit rate; then hil-forceps scan ..."
    return Check(name, what, Verdict.WARN, came, remedy, 0.0, "drives")


def cannot_ask(rig: Rig) -> Check:
    """Return what is told of a drive that answers to commands alone."""
    why = f"a drive of the profile {rig.drive_profile} answers only to commands, which switch its torque on or off"
    remedy = "hil-forceps conformance --rig ... (without --allow-motion), while the motor holds no load"
    return Check("drive.answers", who(rig), Verdict.UNKNOWN, why, remedy)


def node_of(rig: Rig) -> tuple[str, int]:
    """Return the profile and node of a rig's drive."""
    settings = rig.motor_driver
    if settings is None or rig.drive_profile == "native":
        return "native", rig.bench.node_id
    return rig.drive_profile, settings.node_id


def who(rig: Rig) -> str:
    """Return what is asked of a rig's drive first."""
    profile, node = node_of(rig)
    return f"whether the rig's drive ({profile}, node {node}) answers"


def _answers(rig: Rig, said: Said | None, heard: Heard) -> Check:
    name, what = "drive.answers", who(rig)
    profile, node = node_of(rig)
    if said is not None:
        return Check(name, what, Verdict.OK, f"node {node} answers")
    key = "bench.node_id" if profile == "native" else "motor_driver.node_id"
    same = [each.node for each in heard.found if each.profile == profile]
    if same:
        text = f"node {node} does not answer, but {_nodes(same)} {'does' if len(same) == 1 else 'do'}"
        return Check(name, what, Verdict.FAIL, text, f"set {key}: {same[0]} in the rig, or the drive's node to {node}")
    if heard.found:
        others = ", ".join(f"{each.profile} {each.node}" for each in heard.found)
        text = f"no drive with the profile {profile} answers; found: {others}"
        return Check(name, what, Verdict.FAIL, text, "change motor_driver.profile and node_id in the rig")
    came = f"{heard.frames} frames were received, none of this drive" if heard.frames else "no frame was received"
    return Check(
        name, what, Verdict.FAIL, came, "check power, wiring, termination, bit rate; then hil-forceps scan ..."
    )


def _nodes(nodes: Sequence[int]) -> str:
    return ("node " if len(nodes) == 1 else "nodes ") + ", ".join(map(str, nodes))


def _version(said: Said) -> Check:
    name, what = "drive.version", "version of the drive's firmware or protocol"
    if said.misfit:
        head, _, remedy = said.misfit.partition("; ")
        return Check(name, what, Verdict.FAIL, f"{said.firmware or 'not reported'}: {head}", remedy)
    if said.firmware is None:
        return unknown(name, what, _NOT_TOLD)
    return Check(name, what, Verdict.OK, said.firmware)


def _state(said: Said) -> Check:
    name, what = "drive.state", "whether the motor is without torque"
    if said.state is None:
        return unknown(name, what, _NOT_TOLD)
    words = said.state.name.lower()
    if said.state in {DriveState.DISABLED, DriveState.FAULT}:
        return Check(name, what, Verdict.OK, words)
    return Check(
        name, what, Verdict.FAIL, f"{words}: the motor may have torque", "stop the other program that controls it"
    )


def _fault(said: Said) -> Check:
    name, what = "drive.fault", "whether the drive holds a fault"
    if said.fault is None:
        return unknown(name, what, _NOT_TOLD)
    if not said.fault:
        return Check(name, what, Verdict.OK, "none")
    return Check(name, what, Verdict.FAIL, said.fault, "remove its cause; then hil-forceps run --reset-fault ...")


def _counts(rig: Rig, said: Said) -> Check:
    name, what = "drive.counts", "counts of the drive's encoder, compared with encoder.counts_per_rev"
    if said.counts_per_rev is None:
        return unknown(name, what, _NOT_TOLD)
    told, wanted = said.counts_per_rev, rig.encoder.counts_per_rev or ANGLE_LSB_PER_REV
    if told == wanted:
        return Check(name, what, Verdict.OK, str(told), "", told, "counts")
    text = (
        f"the drive has {told}, the rig {rig.encoder.counts_per_rev or 'an ideal encoder'}: angles and their noise "
        "would be wrong"
    )
    return Check(name, what, Verdict.FAIL, text, f"set encoder.counts_per_rev: {told} in the rig", told, "counts")


def _sample_period(rig: Rig, said: Said) -> Check:
    name, what = "drive.sample_period", "sample period of the drive, compared with the rig"
    if said.sample_period_s is None:
        return unknown(name, what, _NOT_TOLD)
    told_s = said.sample_period_s
    try:
        wanted_s = sample_period_s(rig)
    except UserError:
        return unknown(name, what, "the rig has no section `drive:`")
    if abs(told_s - wanted_s) <= MAX_PERIOD_ERROR_SHARE * wanted_s:
        return Check(name, what, Verdict.OK, f"{told_s * 1e3:.4g} ms", "", told_s * 1e3, "ms")
    text = f"the drive's is {told_s * 1e3:.4g} ms, the rig's {wanted_s * 1e3:.4g} ms: the estimator uses the rig's"
    key = "drive.sample_time_s or bench.feedback_divider"
    if rig.motor_driver is not None and rig.drive_profile != "native":
        key = "motor_driver.feedback_period_s"
    return Check(name, what, Verdict.FAIL, text, f"change {key} in the rig, or the drive's period", told_s * 1e3, "ms")


def _current_limit(rig: Rig, said: Said) -> Check:
    name, what = "drive.current_limit", "current limit of the drive, compared with drive.current_limit_A"
    if said.current_limit_A is None:
        return unknown(name, what, _NOT_TOLD)
    if rig.drive is None:
        return unknown(name, what, "the rig has no section `drive:`")
    told_A, wanted_A = said.current_limit_A, rig.drive.current_limit_A
    text = f"the drive's is {told_A:g} A, the rig's {wanted_A:g} A"
    if told_A > wanted_A:
        text += ": the motor can give more torque than the rig allows"
        return Check(name, what, Verdict.FAIL, text, f"set the drive's to {wanted_A:g} A", told_A, "A")
    if told_A < wanted_A:
        remedy = f"set drive.current_limit_A: {told_A:g} in the rig"
        return Check(
            name, what, Verdict.WARN, f"{text}: the drive saturates below the rig's limit", remedy, told_A, "A"
        )
    return Check(name, what, Verdict.OK, text, "", told_A, "A")


def _torque_constant(rig: Rig, said: Said) -> Check:
    name, what = "drive.torque_constant", "torque constant of the drive, compared with motor.torque_constant_N_m_per_A"
    told = said.torque_constant_N_m_per_A
    if told is None:
        return unknown(name, what, _NOT_TOLD)
    try:
        wanted = rig.plant().torque_constant_N_m_per_A
    except UserError:
        return unknown(name, what, "the rig has no value for it")
    text, unit = f"the drive's is {told:.4g} N m/A, the rig's {wanted:.4g} N m/A", "N m/A"
    if abs(told - wanted) <= MAX_TORQUE_CONSTANT_ERROR_SHARE * wanted:
        return Check(name, what, Verdict.OK, text, "", told, unit)
    remedy = "measure it, and set it in the drive and in the rig"
    return Check(name, what, Verdict.WARN, f"{text}: all torques are computed with the rig's value", remedy, told, unit)


def _range(rig: Rig, said: Said) -> Check:
    name, what = "drive.range", "range of positions of the drive, compared with `limits:`"
    if said.position_range_rad is None:
        return unknown(name, what, _NOT_TOLD)
    low, high = said.position_range_rad
    limits = rig.limits
    text = (
        f"the drive accepts {low:.4g} to {high:.4g} rad, the rig allows {limits.position_min_rad:.4g} to "
        f"{limits.position_max_rad:.4g} rad"
    )
    is_within = low <= limits.position_min_rad + ANGLE_LSB_RAD and limits.position_max_rad - ANGLE_LSB_RAD <= high
    if is_within:
        return Check(name, what, Verdict.OK, text)
    remedy = "narrow limits.position_min_rad and position_max_rad of the rig, or widen the range of the drive"
    return Check(name, what, Verdict.FAIL, f"{text}: a reference outside the drive's range causes a fault", remedy)


def _transport(rig: Rig, said: Said) -> Check:
    name, what = "drive.transport", "whether drive and rig agree on CAN FD"
    if said.is_fd is None:
        return unknown(name, what, _NOT_TOLD)
    told = "fd" if said.is_fd else "classic"
    if told == rig.bench.transport:
        return Check(name, what, Verdict.OK, told)
    text = f"the drive has {told}, the rig {rig.bench.transport}: no sample would be received"
    return Check(name, what, Verdict.FAIL, text, f"set bench.transport: {told} in the rig")
