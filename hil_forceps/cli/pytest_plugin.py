"""pytest plugin: `pytest --hfp-serial /dev/ttyUSB0` adds a test for each requirement of the protocol.

The fixture `forceps_bench` opens a simulated bench, for tests of programs that use one (docs/python-api.md). Heavy
imports are local, because every pytest run in the environment loads this module.
"""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from firmware_protocol.conformance.suite import Result, Suite
    from hil_forceps import VirtualBench
    from hil_forceps.bridge.links.conformance_port import LinkPort


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options; they have the same meaning as in `hil-forceps conformance`."""
    group = parser.getgroup("hfp", "conformance of a motor driver (hil-forceps)")
    group.addoption("--hfp-interface", default="", help="python-can interface to the drive")
    group.addoption("--hfp-channel", default="", help="channel of that interface")
    group.addoption("--hfp-serial", default="", help="serial port or pyserial URL instead of a CAN interface")
    group.addoption("--hfp-baudrate", type=int, default=1_000_000, help="rate of the serial port in bit/s")
    group.addoption("--hfp-fd", action="store_true", help="open the bus for CAN FD")
    group.addoption("--hfp-option", action="append", default=[], help="KEY=VALUE for the interface")
    group.addoption("--hfp-node", type=int, default=None, help="node id, if several drives answer")
    group.addoption("--hfp-allow-motion", action="store_true", help="also run checks that give torque")
    group.addoption("--hfp-line-ms", type=float, default=None, help="time in ms that the line may add to a round trip")
    group.addoption("--hfp-out", default="", help="folder for the certificate")


@pytest.fixture
def forceps_bench() -> "Iterator[Callable[..., VirtualBench]]":
    """Yield a function with the arguments of `virtual_bench`; each bench is closed after the test."""
    from hil_forceps import virtual_bench  # noqa: PLC0415 - see above

    with ExitStack() as benches:
        yield lambda rig, **wishes: benches.enter_context(virtual_bench(rig, **wishes))


class Bench:
    """The drive under test, opened by the first test that needs it."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self._port: LinkPort | None = None
        self._suite: Suite | None = None
        self._results: list[Result] = []
        self._problem: BaseException | None = None

    def judge(self, number: int) -> "Result":
        """Run a requirement's checks; raise the same error for all if the drive can't be opened."""
        if self._problem is not None:
            raise self._problem
        if self._suite is None:
            try:
                self._suite = self._open()
            except Exception as problem:
                self._problem = problem
                raise
        result = self._suite.requirement(number)
        self._results.append(result)
        return result

    def close(self) -> None:
        """Restore the drive's state; write the certificate if an output folder is given."""
        if self._suite is not None:
            from hil_forceps.cli.commands.drives.conformance import write_results  # noqa: PLC0415 - see above

            self._suite.close()
            if out := self._option("out"):
                Path(out).mkdir(parents=True, exist_ok=True)
                line = self._option("serial") or f"{self._option('interface')}:{self._option('channel')}"
                write_results(Path(out), self._suite, line, self._results)
        if self._port is not None:
            self._port.close()

    def _option(self, name: str) -> Any:
        return self._config.getoption(f"hfp_{name}")

    def _open(self) -> "Suite":
        from hil_forceps.bridge.links.adapters import LinkSpec, open_link  # noqa: PLC0415
        from hil_forceps.bridge.links.conformance_port import LinkPort  # noqa: PLC0415
        from hil_forceps.cli.arguments.options import interface_options  # noqa: PLC0415
        from hil_forceps.cli.commands.drives.conformance import margins_of, open_suite  # noqa: PLC0415

        spec = LinkSpec(
            self._option("interface"),
            self._option("channel"),
            self._option("serial"),
            self._option("fd"),
            baudrate=self._option("baudrate"),
            options=interface_options(self._option("option")),
        )
        self._port = port = LinkPort(open_link(spec), spec.fd)
        margins = margins_of(port.virtual_time, self._option("line_ms"), None)
        return open_suite(port, self._option("node"), margins, self._option("allow_motion"))


class RequirementItem(pytest.Item):
    """One requirement as a test."""

    def __init__(self, *, number: int, bench: Bench, **rest: Any) -> None:
        super().__init__(**rest)
        self._number = number
        self._bench = bench

    def runtest(self) -> None:
        """Test the requirement."""
        from firmware_protocol.conformance.case import settle  # noqa: PLC0415

        settle(self._bench.judge(self._number))

    def repr_failure(self, excinfo: pytest.ExceptionInfo[BaseException], style: Any = None) -> Any:  # noqa: ARG002
        """Return the message without a traceback, which would only show the suite."""
        return str(excinfo.value)

    def reportinfo(self) -> tuple[Path, None, str]:
        """Return path and name."""
        return self.path, None, self.name


_BENCH = pytest.StashKey[Bench]()


@pytest.hookimpl(tryfirst=True)  # so that -k and -m also select these tests
def pytest_collection_modifyitems(session: pytest.Session, config: pytest.Config, items: list[pytest.Item]) -> None:
    """Add the requirements if a line to a drive is given."""
    if not (config.getoption("hfp_interface") or config.getoption("hfp_serial")):
        return
    if hasattr(config, "workerinput"):
        raise pytest.UsageError("-n: several processes can't test one drive at the same time; leave it out")
    from firmware_protocol.conformance.case import JUDGED  # noqa: PLC0415
    from firmware_protocol.conformance.catalogue import REQUIREMENTS  # noqa: PLC0415

    bench = config.stash[_BENCH] = Bench(config)
    for number in JUDGED:
        name = f"{REQUIREMENTS[number].name} {REQUIREMENTS[number].title}"
        items.append(RequirementItem.from_parent(session, name=name, number=number, bench=bench))


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Restore the drive's state."""
    bench = session.config.stash.get(_BENCH, None)
    if bench is not None:
        bench.close()
