"""Time from the last reference until the motor has no torque, measured many times on one target.

    python -m tests.targets.torque_free --out FILE [--runs N] [--interface … --channel … --option … | --serial …] [--fd]

The last reference is a step, so current flows when the watchdog acts. Measured is from its sending to the arrival of
the first sample in FAULT without current: an upper bound, which contains both ways over the line.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from random import Random
from typing import Any, Final

from firmware_protocol.conformance.checks.enabling import room
from firmware_protocol.conformance.findings import expect, require
from firmware_protocol.conformance.port import MS
from firmware_protocol.conformance.probe import Sample
from firmware_protocol.conformance.session import Session
from firmware_protocol.messages import DriveState
from firmware_protocol.parameters import BY_INDEX, Index
from hil_forceps.bridge.links.adapters import LinkSpec, open_link
from hil_forceps.bridge.links.conformance_port import LinkPort
from hil_forceps.cli.arguments.options import interface_options
from hil_forceps.cli.commands.drives.conformance import margins_of, open_suite

TIMEOUT_US: Final = 20_000  # of the protocol by default (HFP-120)
TORQUE_OFF_NS: Final = MS  # behind it (HFP-123)
WAIT_NS: Final = 60 * MS
MAX_VOID_SHARE: Final = 0.1  # of trials in which nothing flowed
MAX_LINE_NS: Final = 20 * MS  # both ways: well within the wait, however slow a line is granted
SEED: Final = 0


def measure(session: Session, runs: int) -> dict[str, Any]:
    """Return the times, sorted, and the longest that is allowed, with what the line may add [ms].

    Violation where torque does not end, Inconclusive where no current flows.
    """
    phases = Random(SEED)
    session.write(Index.WATCHDOG_TIMEOUT, TIMEOUT_US)
    session.write(Index.HOST_HEARTBEAT_TIMEOUT, BY_INDEX[Index.HOST_HEARTBEAT_TIMEOUT].maximum)
    session.write(Index.MAX_STEP, max(session.margins.move_raw, session.originals[Index.MAX_STEP]))
    step = room(session, session.measured().theta_m, session.margins.move_raw)
    times_ns: list[int] = []
    trials = 0
    while len(times_ns) < runs:
        require(trials < runs + MAX_VOID_SHARE * runs + 2, "a step of the reference gives no current, again and again")
        found = _one(session, phases, step if trials % 2 == 0 else -step)
        times_ns += [] if found is None else [found]
        trials += 1
    times_ns.sort()
    margins = session.margins
    slack_ns = TIMEOUT_US * margins.clock_ppm // 1000 + margins.granularity_ns + session.period_ns
    within_ns = TIMEOUT_US * 1000 + TORQUE_OFF_NS + slack_ns + min(2 * margins.line_ns, MAX_LINE_NS)
    return {"times_ms": [each / MS for each in times_ns], "within_ms": within_ns / MS, "virtual": session.virtual}


def _one(session: Session, phases: Random, step: int) -> int | None:
    """Return the time of one trial; None where no current flowed when it began: a host stood still before it."""
    theta = session.operate()
    session.run(20 * MS)
    session.reference = None
    session.fresh()
    session.run(round(phases.random() * session.period_ns), tick_ns=session.period_ns // 10)
    begin = len(session.samples)
    last_ns = session.send_setpoint(theta + step)
    session.run(WAIT_NS)
    samples = session.samples[begin:]
    peak = max((abs(each.current) for each in samples if each.state == DriveState.OPERATIONAL), default=0)
    if peak <= session.margins.idle_current_raw:
        session.disable()
        return None
    end_ns = _torque_ends_ns(samples, session.margins.idle_current_raw)
    expect(end_ns is not None, f"torque {WAIT_NS // MS} ms after the last reference: {session.state_name()}")
    assert end_ns is not None
    session.reset()
    return end_ns - last_ns


def _torque_ends_ns(samples: Sequence[Sample], idle_current_raw: int) -> int | None:
    """Return the arrival of the first sample from which on there is no current; None where the last has some."""
    end_ns = None
    for each in samples:
        is_free = each.state == DriveState.FAULT and abs(each.current) <= idle_current_raw
        end_ns = (each.time_ns if end_ns is None else end_ns) if is_free else None
    return end_ns


def main() -> None:
    """Measure, and write the times."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--interface", default="")
    parser.add_argument("--channel", default="")
    parser.add_argument("--serial", default="")
    parser.add_argument("--option", action="append", default=[])
    parser.add_argument("--fd", action="store_true")
    parser.add_argument("--line-ms", type=float)
    given = parser.parse_args()
    options = interface_options(tuple(given.option))
    line = LinkSpec(given.interface, given.channel, given.serial, given.fd, options=options)
    port = LinkPort(open_link(line), given.fd)
    try:
        suite = open_suite(port, None, margins_of(port.virtual_time, given.line_ms, None), allow_motion=True)
        try:
            result = measure(suite.session, given.runs)
        finally:
            suite.close()
    finally:
        port.close()
    given.out.write_text(json.dumps(result) + "\n", encoding="utf-8")
    times = result["times_ms"]
    sys.stdout.write(
        f"{len(times)} times to no torque: least {times[0]:.1f}, median {times[len(times) // 2]:.1f}, "
        f"most {times[-1]:.1f}, allowed {result['within_ms']:.1f} ms\n"
    )


if __name__ == "__main__":
    main()
