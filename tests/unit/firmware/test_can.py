"""hfp-drive on SocketCAN where there is none: told in a line. Where there is, see tests/targets/test_socketcan.py."""

import subprocess

import pytest

from tests.firmware_library import make


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--can", "no_such_can"), "can't open the link"),
        (("--can", "vcan0", "--stdio"), "one of --serial-pty"),
        (("--can",), "--can: wants a value"),
    ],
)
def test_what_can_not_be_done_is_told_in_a_line(arguments: tuple[str, ...], words: str) -> None:
    command = [str(make("host", "sanitize") / "hfp-drive"), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=20)
    assert done.returncode == 2
    assert done.stdout == ""
    assert words in done.stderr.splitlines()[-1]
