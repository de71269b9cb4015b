"""The reference firmware over the kernel's own CAN: natively, or in User-Mode Linux with its time virtual.

See tools/socketcan.py. What runs inside is tests/targets/socketcan; here it is started, judged and written down.
"""

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final, NamedTuple

import pytest

from tests.firmware_library import make
from tests.targets.closed_loop import check_loop, check_same_motion
from tests.targets.record import ROOT, Part, TargetRecord, recorded
from tests.targets.socketcan.guest import FIRMWARE_VARIABLE
from tests.targets.socketcan.inside import TARGETS
from tests.targets.suite import check

pytestmark = [pytest.mark.realtime, pytest.mark.slow, pytest.mark.timeout(2400)]

LIMIT_S: Final = 900.0  # of one guest; a busy machine makes it slow, and nothing else
NOT_AVAILABLE: Final = 126
GUESTS_AT_ONCE: Final = 2
APPLICABLE: Final = {"classic": 78, "fd": 83, "slcan": 78}
KINDS: Final = pytest.mark.parametrize("kind", list(TARGETS))


class Ended(NamedTuple):
    """How a run inside ended; `folder` holds what it left."""

    code: int
    output: str
    folder: Path


class Guests:
    """The runs inside of all tests asked for, started together: virtual time minds no neighbour."""

    def __init__(self, folder: Path, pool: ThreadPoolExecutor, asked: frozenset[str]) -> None:
        inside = [sys.executable, "-m", "tests.targets.socketcan.inside"]
        tests = [sys.executable, "-m", "pytest", "-v", "-p", "no:hypothesispytest"]
        self._firmware = make("host") / "hfp-drive"
        self._runs: dict[str, Future[Ended]] = {}
        commands = {f"test_conformance[{kind}]": ("auto", [*inside, "suite", kind]) for kind in TARGETS}
        for name, time in (("time_outs", "virtual"), ("errors", "auto")):
            commands[f"test_{name}"] = (time, [*tests, f"tests/targets/socketcan/inside_{name}.py", "--basetemp"])
        commands |= {f"test_simulation_2[{kind}]": ("real", [*inside, "loop", kind]) for kind in TARGETS}
        for place, (name, (time, command)) in enumerate(commands.items()):
            if name in asked:
                self._runs[name] = pool.submit(self._run, folder / str(place), time, command)

    def end(self, name: str, record: TargetRecord | None = None) -> Ended:
        """Wait for a run; where there is no SocketCAN to be had, that is the outcome."""
        ended = self._runs[name].result()
        if ended.code == NOT_AVAILABLE and record is not None:
            record.not_available(ended.output.strip().splitlines()[-1])
        return ended

    def _run(self, folder: Path, time: str, command: Sequence[str]) -> Ended:
        folder.mkdir()
        kernels = Path(os.environ.get("NUMBA_CACHE_DIR") or ROOT / "build" / "numba")
        variables = {
            "PYTHONPATH": f"{ROOT}:{os.environ.get('PYTHONPATH', '')}",
            "NUMBA_CACHE_DIR": str(kernels),
            "HIL_FORCEPS_TARGETS_DIR": str(folder),
            FIRMWARE_VARIABLE: str(self._firmware),
        }
        writable = ["--writable", str(folder), "--writable", str(kernels)]
        tool = [sys.executable, str(ROOT / "tools" / "socketcan.py"), "--time", time, *writable]
        done = subprocess.run(
            [*tool, "--limit", str(LIMIT_S), "--", *command, str(folder / "out")],
            cwd=ROOT, env={**os.environ, **variables}, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT, text=True, check=False,
        )  # fmt: skip
        return Ended(done.returncode, done.stdout, folder)


@pytest.fixture(scope="module")
def guests(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> Iterator[Guests]:
    asked = frozenset(item.name for item in request.session.items)
    with ThreadPoolExecutor(GUESTS_AT_ONCE) as pool:
        yield Guests(tmp_path_factory.mktemp("socketcan"), pool, asked)
        pool.shutdown(cancel_futures=True)


@KINDS
def test_conformance(guests: Guests, kind: str) -> None:
    with recorded(TARGETS[kind], Part.CONFORMANCE) as record:
        ended = guests.end(f"test_conformance[{kind}]", record)
        assert ended.code in (0, 1), ended.output
        record.suite_results(ended.folder / "out")
        certificate = load(ended.folder / "out" / "certificate.json")
        # In virtual time nothing is late, so nothing may be inconclusive either.
        check(certificate, APPLICABLE[kind], 1.0 if "time: virtual" in ended.output else 0.7)


@KINDS
def test_simulation_2(guests: Guests, kind: str) -> None:
    with recorded(TARGETS[kind], Part.LOOP) as record:
        ended = guests.end(f"test_simulation_2[{kind}]", record)
        assert ended.code == 0, ended.output
        figures = load(ended.folder / TARGETS[kind] / "loop.json")
        record.loop(figures)
        check_loop(figures)
        check_same_motion(figures)


def test_time_outs(guests: Guests) -> None:
    with recorded("socketcan-time-travel", Part.TIMEOUTS) as record:
        ended = guests.end("test_time_outs", record)
        assert ended.code == 0, ended.output
        assert "skipped" not in ended.output


def test_errors(guests: Guests) -> None:
    ended = guests.end("test_errors")
    if ended.code == NOT_AVAILABLE:
        pytest.skip("the target's outcome says why SocketCAN is not available")
    assert ended.code == 0, ended.output


def load(path: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return content
