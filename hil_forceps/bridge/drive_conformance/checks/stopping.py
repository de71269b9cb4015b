"""How torque ends: without references, without a host, by request, by the emergency stop; and what is left of it."""

from statistics import fmean
from typing import Final

from firmware_protocol.conformance.findings import Inconclusive, Violation, expect, require
from firmware_protocol.conformance.port import MS
from firmware_protocol.states import HostPhase
from hil_forceps.bridge.drive_conformance.loop import NO_TORQUE, UNDER_TORQUE, Certain
from hil_forceps.bridge.drive_conformance.registry import Need, check
from hil_forceps.bridge.drive_conformance.session import Session
from hil_forceps.drives.promises import Starved

HOLD_NS: Final = 200 * MS
LATCH_NS: Final = 500 * MS
CYCLES: Final = 5
ESTOP_TRIES: Final = 3
MIN_WATCHDOG_TIME_SHARE: Final = 0.5  # what feeds it may go out with every few references only
_ENDS: Final[dict[Starved, HostPhase]] = {
    "fault": HostPhase.FAULT,
    "braked": HostPhase.FAULT,
    "ready": HostPhase.READY,
    "lost": HostPhase.DISCONNECTED,
}


def _no_watchdog(s: Session) -> str:
    return "" if s.watchdog_s else "motor_driver.watchdog_s is 0"


def _not_told(s: Session) -> str:
    if not s.promises.tells_watchdog or s.promises.starved in {"lost", "released"}:
        return "this drive does not report its watchdog; disconnect its bus and check that the motor loses its torque"
    return _no_watchdog(s)


def _no_fault(s: Session) -> str:
    latches = s.promises.starved in {"fault", "braked"}
    return _no_watchdog(s) if latches else "no safe test makes this drive report a fault"


def _starve(s: Session) -> int:
    """Hold, then send no reference any more but poll on; return the time of the last reference."""
    s.enable()
    s.hold(HOLD_NS)
    s.feeds = False
    return s.references[-1].at_ns


def _expect_end(s: Session, where: str) -> None:
    end = _ENDS[s.promises.starved]
    expect(s.phase is end, f"{where}: {s.state_words()}; the profile declares {end.name}")
    if s.promises.starved in {"fault", "ready"}:
        expect(s.machine.drive_state in NO_TORQUE, f"{where}: {s.state_words()}; the motor has torque")


@check(60, Need.TORQUE, _no_watchdog)
def references_end(s: Session) -> None:
    """The machine is polled all along, so telemetry alone must not keep the drive alive."""
    last_ns = _starve(s)
    if s.promises.starved == "released":
        s.run(s.watchdog_ns)
        begin = len(s.samples)
        s.run(HOLD_NS)
        currents_A = [seen.current_A for seen in s.samples[begin:]] or [0.0]
        none_mA = s.bounds.no_current_A * 1e3
        s.bound("current without references", fmean(currents_A) * 1e3, "mA", least=-none_mA, most=none_mA)
        return
    within_ns = s.watchdog_ns
    s.run(max(2 * within_ns, within_ns + LATCH_NS), lambda: s.phase is not HostPhase.RUNNING)
    if s.phase is HostPhase.RUNNING:
        raise Certain(f"{(s.now_ns() - last_ns) / MS:.0f} ms after the last reference the motor still has torque")
    s.bound(
        "stopped after the last reference",
        (s.now_ns() - last_ns) / MS,
        "ms",
        least=MIN_WATCHDOG_TIME_SHARE * s.watchdog_s * 1e3,
        most=within_ns / MS,
    )
    s.run(s.report_ns, lambda: s.phase is _ENDS[s.promises.starved] and s.machine.drive_state in NO_TORQUE)
    _expect_end(s, "after the watchdog's time")


@check(61, Need.TORQUE, _not_told)
def host_falls_silent(s: Session) -> None:
    """Nothing at all is sent, as by a host that has crashed; then the drive is heard, or looked for anew.

    A machine whose drive answers only when it is asked takes its own silence for the drive's.
    """
    s.enable()
    s.hold(HOLD_NS)
    s.is_silent = True
    silent_ns = s.watchdog_ns - s.report_ns
    s.run(silent_ns)
    s.is_silent = s.feeds = False
    end = _ENDS[s.promises.starved]
    s.run(s.report_ns, lambda: s.phase is end)
    if s.phase is HostPhase.RUNNING:
        raise Certain(f"after {silent_ns / MS:.0f} ms of silence the motor still has torque")
    if s.phase is HostPhase.DISCONNECTED:
        s.machine.connect(s.now_ns())
        s.run(s.service.connect_timeout_ns, lambda: s.phase not in {HostPhase.DISCONNECTED, HostPhase.IDENTIFYING})
    _expect_end(s, f"after {silent_ns / MS:.0f} ms of silence")
    s.note(f"{end.name} after {silent_ns / MS:.1f} ms of silence")


@check(62, Need.TORQUE, _not_told)
def stays_stopped(s: Session) -> None:
    """Nobody resets it; it is polled on."""
    _starve(s)
    s.run(s.watchdog_ns + s.report_ns)
    if s.phase is HostPhase.RUNNING:
        raise Inconclusive("the drive did not stop")
    end = _ENDS[s.promises.starved]
    if s.run(LATCH_NS, lambda: s.phase is not end):
        raise Violation(f"without a reset the drive is {s.state_words()}; the profile declares {end.name}")
    s.note(f"{end.name} for another {LATCH_NS / MS:.0f} ms")


def _disable(s: Session) -> float:
    """Ask for no torque; return the ms until the drive's word. Violation where it does not come in time."""
    s.feeds = False
    asked_ns = s.now_ns()
    s.machine.disable()
    s.run(s.service.disable_timeout_ns, s.is_free)
    if s.phase is HostPhase.FAULT:
        raise Violation(f"a fault has stopped the drive, not the request: {s.state_words()}")
    if not s.is_free():
        within_ms = s.service.disable_timeout_ns / MS
        raise Violation(f"not confirmed within {within_ms:.0f} ms: {s.state_words()}")
    return (s.now_ns() - asked_ns) / MS


@check(70, Need.TORQUE)
def disable_is_confirmed(s: Session) -> None:
    """The time is that of the service."""
    s.enable()
    s.hold(HOLD_NS)
    s.tell("confirmed after", _disable(s), "ms")
    s.run(LATCH_NS // 2)
    expect(s.is_free(), f"after the confirmation: {s.state_words()}")


@check(71, Need.TORQUE)
def five_cycles(s: Session) -> None:
    """Behind each the drive's word is held against its current."""
    worst_A, latest_ms, none_A = 0.0, 0.0, s.bounds.no_current_A
    for cycle in range(1, CYCLES + 1):
        s.enable()
        s.hold(HOLD_NS // 4)
        latest_ms = max(latest_ms, _disable(s))
        s.run(s.slack_ns)
        s.begin()
        s.run(max(50 * MS, round(20e9 * s.sample_period_s)))
        expect(s.is_free(), f"cycle {cycle}: {s.state_words()}")
        expect(bool(s.samples), f"cycle {cycle}: no samples arrived after it")
        worst_A = max(worst_A, abs(fmean(seen.current_A for seen in s.samples)))
        expect(
            worst_A <= none_A,
            f"cycle {cycle}: {worst_A * 1e3:.3g} mA after the drive's confirmation (at most {none_A * 1e3:.3g})",
        )
    s.bound("largest current after the confirmation", worst_A * 1e3, "mA", most=none_A * 1e3)
    s.tell("slowest confirmation after", latest_ms, "ms")


@check(72, Need.TORQUE, lambda s: "" if s.promises.tells_state else "this drive does not report whether it has torque")
def emergency_stop(s: Session) -> None:
    """The frame alone, as the service sends it where it fails; nothing else asks for the end of torque.

    The watchdog would stop the motor too: so it is sent at several places between two words of the drive, and one word
    at least has to come before the watchdog's time is over.
    """
    watchdog_ms, report_ms = s.watchdog_s * 1e3, s.report_ns / MS
    soonest_ms = report_ms
    for place in range(ESTOP_TRIES):
        if place:
            s.recover()
        s.enable()
        s.hold(HOLD_NS + place * s.report_ns // ESTOP_TRIES)
        s.feeds = False
        sent_ns = s.now_ns()
        s.line.send(s.machine.estop_frame())
        if not s.run(s.report_ns, lambda: s.phase not in UNDER_TORQUE):
            raise Violation(f"{report_ms:.0f} ms after the emergency stop: {s.state_words()}")
        soonest_ms = min(soonest_ms, (s.now_ns() - sent_ns) / MS)
        if not watchdog_ms or soonest_ms < MIN_WATCHDOG_TIME_SHARE * watchdog_ms:
            break
    if watchdog_ms and soonest_ms >= watchdog_ms:
        require(
            report_ms <= 2.0 * watchdog_ms, "the drive reports too seldom to distinguish the stop from the watchdog"
        )
        raise Violation(
            f"torque ends {soonest_ms:.0f} ms after the emergency stop, no sooner than by the watchdog alone"
        )
    s.bound("torque off after", soonest_ms, "ms", most=report_ms)


def _fail(s: Session) -> None:
    """Lead the drive to a fault that does no harm: that of its watchdog."""
    _starve(s)
    s.run(2 * s.watchdog_ns, lambda: s.phase is HostPhase.FAULT)
    if s.phase is not HostPhase.FAULT:
        raise Inconclusive(f"its watchdog causes no fault: {s.state_words()}")


@check(80, Need.TORQUE, _no_fault)
def fault_is_told(s: Session) -> None:
    """In other words than before there was one."""
    _fail(s)
    words = s.machine.fault_words()
    expect(bool(words.strip()) and words.isprintable(), f"the fault's words are {words!r}")
    expect(words != s.words_at_first, f"with a fault it reports the same words as without: {words}")
    s.note(f"reported: {words}")


@check(81, Need.TORQUE, _no_fault)
def one_reset_clears(s: Session) -> None:
    """The machine is asked once."""
    _fail(s)
    asked_ns = s.now_ns()
    s.machine.reset_fault()
    s.run(s.service.connect_timeout_ns, lambda: s.phase is HostPhase.READY)
    if s.phase is not HostPhase.READY:
        raise Violation(f"{s.service.connect_timeout_ns / 1e9:g} s after one reset: {s.state_words()}")
    s.tell("cleared after", (s.now_ns() - asked_ns) / MS, "ms")
    if s.run(s.report_ns, lambda: not s.is_free() or s.phase is not HostPhase.READY):
        raise Violation(f"after the reset: {s.state_words()}")
