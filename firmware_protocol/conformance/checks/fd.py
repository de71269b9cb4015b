"""CAN FD: HFP-170, HFP-171, HFP-173."""

from firmware_protocol.conformance import wire
from firmware_protocol.conformance.checks.frames import walk
from firmware_protocol.conformance.findings import expect
from firmware_protocol.conformance.port import Capability
from firmware_protocol.conformance.registry import Need, check
from firmware_protocol.conformance.session import Session
from firmware_protocol.messages import DriveState, Function


@check(170, Need.FD_DRIVE, last=True)
def fd_feedback_in_place_of_two(s: Session) -> str:
    walk(s)
    findings = s.monitor.findings(170)
    expect(not findings, findings)
    return f"{s.monitor.seen[Function.FD_FEEDBACK]} FD_FEEDBACK, no FEEDBACK and no TIMING"


@check(171, Need.MOTION | Need.FD_LINE)
def follows_its_own_kind_only(s: Session) -> str:
    theta = s.operate()
    s.reference = None
    before = s.accepted()
    for step in range(1, 6):
        s.fresh()
        newest = s.measured().sequence
        s.send(wire.setpoint(not s.fd, s.node, theta, s.setpoint_sequence + step, newest))
        s.run(s.margins.gap_ns)
    grown = s.accepted() - before
    kind = "SETPOINT" if s.fd else "FD_SETPOINT"
    expect(grown == 0, f"{grown} {kind} were accepted")
    expect(s.observe() == DriveState.OPERATIONAL, f"{kind} led to {s.state_name()}")
    return f"{kind} ignored"


@check(173)
def the_other_kind_is_for_nobody(s: Session) -> str:
    before = s.rejected()
    other = wire.setpoint(not s.fd, s.node, 0, 0, 0)
    formats = {s.fd, other.is_fd} if Capability.FD in s.port.capabilities else {False}
    for is_fd in sorted(formats):
        for length in (8, 7, 0) if not is_fd else (8, 12):
            s.send(other._replace(data=other.data.ljust(length, b"\0")[:length], is_fd=is_fd))
            s.run(s.margins.gap_ns)
    grown = s.rejected() - before
    kind = "SETPOINT" if s.fd else "FD_SETPOINT"
    expect(grown == 0, f"rejected grew by {grown} after {kind}, which this drive does not follow")
    return f"{kind} not counted, whatever its length and format"
