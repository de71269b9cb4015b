"""CAN FD: HFP-170, HFP-171."""

from firmware_protocol.conformance import wire
from firmware_protocol.conformance.checks.frames import walk
from firmware_protocol.conformance.registry import Need, check, expect
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
