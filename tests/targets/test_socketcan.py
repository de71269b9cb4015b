"""The reference firmware over the kernel's own CAN: natively, or in User-Mode Linux with its time virtual.

See tools/targets/socketcan.py. What runs inside is tests/targets/socketcan; here it is started, judged and written
down.
"""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, NamedTuple

import pytest

from tests.firmware_library import make
from tests.targets.closed_loop import check_loop, check_same_motion
from tests.targets.record import ROOT, Part, TargetRecord, recorded
from tests.targets.setting import LONG
from tests.targets.socketcan.guest import FIRMWARE_VARIABLE
from tests.targets.socketcan.inside import TARGETS
from tests.targets.suite import check, check_torque_free

pytestmark = [pytest.mark.slow, pytest.mark.timeout(2400)]

LIMIT_S: Final = 900.0  # of one guest; a busy machine makes it slow, and nothing else
NOT_AVAILABLE: Final = 126
FOLDER: Final = "tests/targets/socketcan"
INSIDE: Final = "tests.targets.socketcan.inside"
PYTEST: Final = ("pytest", "-v", "-p", "no:hypothesispytest")
APPLICABLE: Final = {"classic": 78, "fd": 83, "slcan": 78}
KINDS: Final = pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=() if kind == "fd" else pytest.mark.long) for kind in TARGETS]
)


class Ended(NamedTuple):
    """How a run inside ended; `folder` holds what it left."""

    code: int
    output: str
    folder: Path


Guest = Callable[..., Ended]


@pytest.fixture
def guest(tmp_path: Path) -> Guest:
    """Run a command where SocketCAN is; an own guest for each test, as many at once as pytest-xdist has jobs."""

    def run(time: str, *command: str) -> Ended:
        folder = tmp_path / "guest"
        folder.mkdir()
        kernels = Path(os.environ.get("NUMBA_CACHE_DIR") or ROOT / "build" / "numba")
        variables = {
            "PYTHONPATH": f"{ROOT}:{os.environ.get('PYTHONPATH', '')}",
            "NUMBA_CACHE_DIR": str(kernels),
            "HIL_FORCEPS_TARGETS_DIR": str(folder),
            FIRMWARE_VARIABLE: str(make("host") / "hfp-drive"),
        }
        writable = ["--writable", str(folder), "--writable", str(kernels)]
        tool = [sys.executable, str(ROOT / "tools" / "targets" / "socketcan.py"), "--time", time, *writable]
        done = subprocess.run(
            [*tool, "--limit", str(LIMIT_S), "--", sys.executable, "-m", *command, str(folder / "out")],
            cwd=ROOT, env={**os.environ, **variables}, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT, text=True, check=False,
        )  # fmt: skip
        return Ended(done.returncode, done.stdout, folder)

    return run


def require(ended: Ended, record: TargetRecord) -> None:
    """Where there is no SocketCAN to be had, that is the outcome."""
    if ended.code == NOT_AVAILABLE:
        record.not_available(ended.output.strip().splitlines()[-1])


@KINDS
def test_conformance(guest: Guest, kind: str) -> None:
    with recorded(TARGETS[kind], Part.CONFORMANCE) as record:
        ended = guest("auto", INSIDE, "suite", kind)
        require(ended, record)
        assert ended.code in (0, 1), ended.output
        record.suite_results(ended.folder / "out")
        certificate = load(ended.folder / "out" / "certificate.json")
        # In virtual time nothing is late, so nothing may be inconclusive either.
        check(certificate, APPLICABLE[kind] - len(LONG), 1.0 if "time: virtual" in ended.output else 0.7)


@KINDS
def test_time_to_no_torque(guest: Guest, kind: str) -> None:
    with recorded(TARGETS[kind], Part.TORQUE_FREE) as record:
        ended = guest("auto", INSIDE, "torque_free", kind)
        require(ended, record)
        assert ended.code == 0, ended.output
        result = load(ended.folder / "out" / "torque_free.json")
        record.torque_free(result)
        check_torque_free(result)


@KINDS
def test_simulation_2(guest: Guest, kind: str) -> None:
    with recorded(TARGETS[kind], Part.LOOP) as record:
        ended = guest("real", INSIDE, "loop", kind)
        require(ended, record)
        assert ended.code == 0, ended.output
        figures = load(ended.folder / TARGETS[kind] / "loop.json")
        record.loop(figures)
        check_loop(figures)
        check_same_motion(figures)


@pytest.mark.long
def test_time_outs(guest: Guest) -> None:
    with recorded("socketcan-time-travel", Part.TIMEOUTS) as record:
        ended = guest("virtual", *PYTEST, f"{FOLDER}/inside_time_outs.py", "--basetemp")
        require(ended, record)
        assert ended.code == 0, ended.output
        assert "skipped" not in ended.output


def test_errors(guest: Guest) -> None:
    ended = guest("auto", *PYTEST, f"{FOLDER}/inside_errors.py", "--basetemp")
    if ended.code == NOT_AVAILABLE:
        pytest.skip("the target's outcome says why SocketCAN is not available")
    assert ended.code == 0, ended.output


def load(path: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return content
