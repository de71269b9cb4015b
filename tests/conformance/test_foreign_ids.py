"""What others send on the drive's bus is not held against it."""

from firmware_protocol.conformance.port import Margins
from firmware_protocol.conformance.session import Session
from firmware_protocol.frames import Frame, arbitration_id
from tests.conformance.devices import NODE, Device, DirectPort

MS = 1_000_000


def findings(is_extended: bool) -> str:
    port = DirectPort(Device())
    session = Session(port, NODE, Margins(0, 0, 1, 500_000, 0))
    port.inbox.append((0, Frame(arbitration_id(0x3C, NODE), bytes(8), is_extended=is_extended)))
    session.run(MS)
    return session.monitor.findings(10)


def test_ids_with_29_bits_are_nobodys_that_is_tested() -> None:
    assert "which no drive sends" in findings(is_extended=False)
    assert not findings(is_extended=True)
