"""`run` killed at any moment: what was written reads back, and `recover` adds what only the bus log has."""

import json
import random
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil_forceps.data.recording.reader import Recording, read_recording
from hil_forceps.rig.errors import UserError
from tests.system.conftest import wait_until

pytestmark = [pytest.mark.realtime, pytest.mark.slow]

KILLS = 5
MOST_BYTES = 60_000  # some three seconds

DriveFixture = Callable[..., Any]
RunFixture = Callable[..., Any]


def is_prefix(part: Recording, whole: Recording) -> bool:
    return all(
        getattr(whole, name).tobytes().startswith(getattr(part, name).tobytes())
        for name in ("samples", "references", "bench")
    )


def test_killed_at_any_moment(drive: DriveFixture, run: RunFixture, pty_wire: Any, tmp_path: Path, start: Any) -> None:
    moments = random.Random(6)
    other = drive(pty_wire)
    readable = 0
    for kill in range(KILLS):
        out, size = tmp_path / f"out{kill}", moments.randrange(MOST_BYTES)
        service = run(pty_wire, out, "--reset-fault")
        recording = out / "run.mcap"
        wait_until(lambda path=recording, least=size: path.exists() and path.stat().st_size >= least, service)  # type: ignore[misc]
        assert service.end(signal.SIGKILL).code == -signal.SIGKILL
        before = {path.name: path.read_bytes() for path in out.iterdir()}
        ended = start("recover", out, "--json").end()
        assert {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()} == before
        try:
            found = read_recording(recording)
        except UserError:
            assert ended.code == 2, "what can't be read is no recording yet"
            continue
        readable += 1
        assert ended.code == 1, "the end is missing at least"
        said = json.loads(ended.out)
        assert found.result == {}
        assert said["lost"] == []
        again = read_recording(out / "recovered" / "run.mcap")
        assert is_prefix(found, again)
        sequences = again.samples["sequence"].astype(int)
        assert np.all(np.diff(sequences) % 256 == 1), "a sample is missing between others"
        count = sum(each["last"] - each["first"] + 1 for each in said["restored"])
        assert len(again.samples) == len(found.samples) + count
        if len(again.samples):
            replayed = start("replay", out / "recovered").end()
            assert (replayed.code, "all identical" in replayed.out) == (1, True), "incomplete, and right"
        assert start("explain", out).end().code == 0
    assert readable >= KILLS - 1
    other.end(signal.SIGTERM)
