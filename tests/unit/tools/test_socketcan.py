"""tools/targets/socketcan.py: what it says where nothing can be had. tests/targets has what it runs."""

import subprocess
import sys
from pathlib import Path

import pytest

TOOL = Path(__file__).resolve().parents[3] / "tools" / "targets" / "socketcan.py"


def run(*arguments: str, path: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, str(TOOL), *arguments],
        env={"PATH": path, "HOME": path, "XDG_CACHE_HOME": f"{path}/cache"},
        capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip


def test_no_command() -> None:
    assert run(path="/usr/bin:/bin").returncode == 2


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--where", "native"), "`ip` is not installed"),
        (("--where", "native", "--time", "virtual"), "User-Mode Linux only"),
    ],
)
def test_not_available_says_why(arguments: tuple[str, ...], words: str, tmp_path: Path) -> None:
    done = run(*arguments, "--", "true", path=str(tmp_path))
    assert done.returncode == 126
    (line,) = done.stderr.splitlines()
    assert line.startswith("no SocketCAN: ")
    assert words in line


def test_no_kernel_says_what_it_lacks(tmp_path: Path) -> None:
    for name in ("sh", "dirname", "mkdir", "flock", "cmp"):
        (tmp_path / name).symlink_to(f"/usr/bin/{name}")
    done = run("--where", "uml", "--", "true", path=str(tmp_path))
    assert done.returncode == 126
    assert "apt-get is not installed" in done.stderr
