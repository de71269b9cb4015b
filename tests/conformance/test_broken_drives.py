"""A check that can't fail is no check: for every requirement tested there is a drive that breaks it, and it alone."""

from collections.abc import Iterable

import pytest

from firmware_protocol.conformance.catalogue import REQUIREMENTS, UNTESTABLE
from firmware_protocol.conformance.port import VIRTUAL
from firmware_protocol.conformance.registry import CHECKS
from firmware_protocol.conformance.suite import Suite, Verdict
from tests.conformance.broken import enabling, faults_and_parameters, ids_and_frames, lines, references, streams
from tests.conformance.broken.table import BROKEN, Broken
from tests.conformance.devices import NODE, Device, DirectDatagramPort, DirectPort, DirectSerialPort

TABLES = (ids_and_frames, streams, enabling, references, faults_and_parameters, lines)  # each fills BROKEN
# On a serial line the payload's own check is the check; a datagram without a whole packet is a damaged packet.
INSEPARABLE = {frozenset({32, 161}), frozenset({160, 180})}
PORTS = {"can": DirectPort, "fd": DirectPort, "serial": DirectSerialPort, "udp": DirectDatagramPort}


def port_of(line: str, device: Device) -> DirectPort:
    return PORTS[line](device)


@pytest.mark.parametrize("line", ["can", "fd", "serial", "udp"])
def test_a_whole_drive_passes(line: str) -> None:
    suite = Suite(port_of(line, Device(line == "fd")), NODE, VIRTUAL, allow_motion=True)
    suite.open()
    results = suite.run(REQUIREMENTS)
    suite.close()
    wrong = {r.requirement.name: r.evidence for r in results if r.verdict in (Verdict.FAIL, Verdict.INCONCLUSIVE)}
    assert wrong == {}
    assert sum(r.verdict is Verdict.PASS for r in results) == {"can": 80, "fd": 83, "serial": 86, "udp": 87}[line]


def judged(broken: Broken, numbers: Iterable[int]) -> dict[int, Verdict]:
    """Return the requirements among these that a broken drive doesn't pass."""
    device = Device(broken.line == "fd")
    broken.mutate(device)
    suite = Suite(port_of(broken.line, device), NODE, VIRTUAL, allow_motion=True)
    suite.session.thorough = False
    suite.open()
    results = suite.run(numbers)
    assert not suite.lost_drive
    return {r.requirement.number: r.verdict for r in results if r.verdict in (Verdict.FAIL, Verdict.INCONCLUSIVE)}


@pytest.mark.parametrize("broken", BROKEN, ids=lambda broken: broken.name)
def test_a_broken_drive_fails_where_it_is_broken(broken: Broken) -> None:
    assert judged(broken, sorted(broken.fails)) == dict.fromkeys(broken.fails, Verdict.FAIL)


@pytest.mark.long
@pytest.mark.parametrize("broken", BROKEN, ids=lambda broken: broken.name)
def test_a_broken_drive_fails_where_it_is_broken_and_nowhere_else(broken: Broken) -> None:
    assert judged(broken, REQUIREMENTS) == dict.fromkeys(broken.fails, Verdict.FAIL)


def test_every_requirement_that_is_tested_has_a_drive_that_breaks_it() -> None:
    assert len(TABLES) == 6
    tested = {check.requirement for check in CHECKS}
    assert tested == set(REQUIREMENTS) - set(UNTESTABLE)
    assert {number for broken in BROKEN for number in broken.fails} == tested
    assert {broken.fails for broken in BROKEN if len(broken.fails) > 1} == INSEPARABLE
    alone = {number for broken in BROKEN if len(broken.fails) == 1 for number in broken.fails}
    assert tested - alone == {161, 180}
