"""Conformance as a pytest class, for a port of your own.

    class TestMyDrive(DriveConformance):
        node = 1
        margins = REAL

        def open_port(self) -> Port:
            return MyPort()

One test a requirement. For python-can interfaces and serial ports there is the plugin, which needs no code:
`pytest --hfp-interface socketcan --hfp-channel can0`.
"""

from typing import ClassVar, Final

import pytest

from firmware_protocol.conformance.catalogue import REQUIREMENTS, name_of
from firmware_protocol.conformance.port import VIRTUAL, Margins, Port
from firmware_protocol.conformance.registry import CHECKS
from firmware_protocol.conformance.suite import Result, Suite, Verdict

_LAST: Final = frozenset(each.requirement for each in CHECKS if each.last)
# What leaves a trace comes at the end, as in the command.
JUDGED: Final = tuple(
    sorted((n for n, each in REQUIREMENTS.items() if not each.untestable), key=lambda n: (n in _LAST, n))
)


def settle(result: Result) -> None:
    """Pass, skip with the reason what was not run, or fail with the evidence; what could not be told is no pass."""
    if result.verdict is Verdict.NOT_RUN:
        pytest.skip(result.evidence)
    if result.verdict is not Verdict.PASS:
        title = f"{result.requirement.name} {result.requirement.title}"
        pytest.fail(f"{title}: {result.verdict}: {result.evidence}", pytrace=False)


class DriveConformance:
    """Subclasses supply `open_port` and, where the defaults do not fit, node, margins and whether motion is allowed."""

    node: ClassVar[int] = 1
    margins: ClassVar[Margins] = VIRTUAL
    allow_motion: ClassVar[bool] = False
    _port: ClassVar[Port]
    _suite: ClassVar[Suite]

    def open_port(self) -> Port:
        """Return the line to the drive."""
        raise NotImplementedError

    def close_port(self, port: Port) -> None:
        """Release the line."""

    @classmethod
    def setup_class(cls) -> None:
        """Open the drive once for all requirements."""
        case = cls()
        cls._port = case.open_port()
        cls._suite = Suite(cls._port, cls.node, cls.margins, cls.allow_motion)
        cls._suite.open()

    @classmethod
    def teardown_class(cls) -> None:
        """Leave the drive as it was found."""
        try:
            cls._suite.close()
        finally:
            cls().close_port(cls._port)

    @pytest.mark.parametrize("number", JUDGED, ids=name_of)
    def test_requirement(self, number: int) -> None:
        """Judge one requirement."""
        settle(self._suite.requirement(number))
