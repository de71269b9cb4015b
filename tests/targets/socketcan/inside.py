"""What runs where SocketCAN is: the whole suite, or simulation 2, against the reference firmware as a process.

python -m tests.targets.socketcan.inside suite|loop|torque_free classic|fd|slcan FOLDER. The suite leaves
certificate.json and junit.xml in FOLDER, the loop loop.json, the times to no torque torque_free.json.
"""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hil_forceps.bridge.links.adapters import LinkSpec, open_link
from tests.targets.closed_loop import close_loop, drive_arguments
from tests.targets.lockstep import UdpPlantLine
from tests.targets.record import Part, TargetRecord
from tests.targets.setting import TORQUE_FREE_RUNS, without_long
from tests.targets.socketcan.guest import IS_VIRTUAL, ROOT, c_drive, running, service, slcan_line

TARGETS = {"classic": "socketcan-vcan-classic", "fd": "socketcan-vcan-fd", "slcan": "socketcan-slcan"}


@contextmanager
def devices(kind: str) -> Iterator[tuple[str, str]]:
    """Bring up a line; return the host's device and the drive's."""
    if kind == "slcan":
        with slcan_line() as both:
            yield both
    else:
        yield "vcan0", "vcan0"


def run_suite(kind: str, folder: Path) -> int:
    """Run `hil-forceps conformance` as a user would; return its exit code."""
    sys.stdout.write(f"time: {'virtual' if IS_VIRTUAL else 'real'}\n")
    sys.stdout.flush()
    fd = ["--fd"] if kind == "fd" else []
    with devices(kind) as (ours, theirs), running(c_drive(theirs, *fd)):
        line = ["--interface", "socketcan", "--channel", ours, *fd]
        return subprocess.run(
            service("conformance", *line, "--allow-motion", "--out", str(folder), *without_long()),
            cwd=ROOT,
            check=False,
        ).returncode


def run_torque_free(kind: str, folder: Path) -> int:
    """Measure the time to no torque; return the exit code."""
    folder.mkdir(parents=True, exist_ok=True)
    fd = ["--fd"] if kind == "fd" else []
    with devices(kind) as (ours, theirs), running(c_drive(theirs, *fd)):
        line = ["--interface", "socketcan", "--channel", ours, *fd]
        out = ["--runs", str(TORQUE_FREE_RUNS), "--out", str(folder / "torque_free.json")]
        command = [sys.executable, "-m", "tests.targets.torque_free", *line, *out]
        return subprocess.run(command, cwd=ROOT, check=False).returncode


def run_loop(kind: str, folder: Path) -> int:
    """Close simulation 2 through the firmware, with the plant outside as its clock."""
    folder.mkdir(parents=True, exist_ok=True)
    is_fd = kind == "fd"
    arguments = ["--plant", "127.0.0.1:0", *drive_arguments(), *(["--fd"] if is_fd else [])]
    with devices(kind) as (ours, theirs), running(c_drive(theirs, *arguments)) as drive:
        plant = UdpPlantLine(("127.0.0.1", int(drive.ready[-1])))
        try:
            link = open_link(LinkSpec(interface="socketcan", channel=ours, fd=is_fd)).link
            close_loop(TargetRecord(TARGETS[kind], Part.LOOP), link, plant, folder, is_fd)
        finally:
            plant.close()
    return 0


if __name__ == "__main__":
    what, which, where = sys.argv[1:]
    sys.exit({"suite": run_suite, "loop": run_loop, "torque_free": run_torque_free}[what](which, Path(where)))
