"""The suite, unchanged, against the firmware's object code under Unicorn, on a bus with bit times, in virtual time."""

from collections.abc import Sequence

import pytest

from firmware_protocol.conformance.catalogue import REQUIREMENTS
from firmware_protocol.conformance.port import VIRTUAL, Capability
from firmware_protocol.conformance.report import certificate, junit
from firmware_protocol.conformance.suite import Result, Suite, Verdict
from firmware_protocol.frames import Frame
from hil_forceps.rig import load_rig
from tests.targets.record import ROOT, Part, recorded
from tests.targets.unicorn_bench import NODE, BenchNode, DeviceNode, needs_compiler
from virtual_bus.interface import VirtualForcepsBus
from virtual_bus.load import paper_load

TARGET = "unicorn-bxcan"
APPLICABLE = 78
pytestmark = pytest.mark.slow


class BxCanPort:
    """The suite's line to the device: the virtual bus; frames that it does not carry go straight to the controller."""

    virtual_time = True
    capabilities = Capability.FOREIGN

    def __init__(self, channel: str) -> None:
        self.device = DeviceNode(load_rig(ROOT / "configs" / "paper.yaml"), paper_load(0))
        self._bus = VirtualForcepsBus(channel, nodes=[self.device, BenchNode(self.device)])

    def send(self, frame: Frame) -> bool:
        return self._bus.send_frame(frame)

    def send_foreign(self, frame: Frame, remote: bool) -> bool:
        self.device.receive_foreign(frame, remote, self._bus.now_ns())
        return True

    def send_bytes(self, data: bytes) -> bool:
        raise NotImplementedError(data)

    def receive(self) -> Sequence[tuple[int, Frame]]:
        return self._bus.receive_frames()

    def line_errors(self) -> int:
        return 0

    def now_ns(self) -> int:
        return self._bus.now_ns()

    def wait_until(self, time_ns: int) -> None:
        self._bus.advance_until_ns(time_ns)

    def close(self) -> None:
        self._bus.shutdown()


def judge(port: BxCanPort, numbers: Sequence[int]) -> tuple[Suite, list[Result]]:
    suite = Suite(port, NODE, VIRTUAL, allow_motion=True)
    suite.open()
    results = suite.run(numbers)
    suite.close()
    return suite, results


def test_the_suite_passes_on_the_object_code() -> None:
    with recorded(TARGET, Part.CONFORMANCE) as record:
        needs_compiler(record)
        port = BxCanPort("unicorn suite")
        suite, results = judge(port, tuple(REQUIREMENTS))
        port.close()
        record.certificate(certificate(suite, TARGET, results))
        (record.folder / "junit.xml").write_text(junit(results, f"conformance {TARGET}"), encoding="utf-8")
        wrong = {r.requirement.name: r.evidence for r in results if r.verdict in (Verdict.FAIL, Verdict.INCONCLUSIVE)}
        assert wrong == {}
        assert sum(r.verdict is Verdict.PASS for r in results) == APPLICABLE
        can = port.device.device.can
        assert can.overruns == 0
        assert can.filtered > 0
