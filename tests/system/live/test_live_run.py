"""`run`, `bench` and `drive` with --live: the page shows them, stops them, and costs the loop nothing that counts."""

import asyncio
import json
import os
import re
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from websockets.asyncio.client import connect as connect_async

from hil_forceps.bridge.statistics import StampMap
from hil_forceps.data.recording.reader import Recording, read_recording
from tests.system.live.browser import Tab, browser, find_browser
from tests.system.live.test_live_page import EXPECT

pytestmark = [pytest.mark.realtime, pytest.mark.alone, pytest.mark.slow]

ROOT = Path(__file__).resolve().parents[3]
PAPER = ROOT / "configs" / "paper.yaml"

# Fixtures of conftest.py; what they hand out is described there.
DriveFixture = Callable[..., Any]
RunFixture = Callable[..., Any]


def address_of(command: Any) -> str:
    """Wait until a process says where its page is."""
    for line in iter(command.process.stderr.readline, ""):
        if found := re.search(r"live page: (\S+)", line):
            return found[1]
    raise AssertionError(command.end())


def browser_path() -> str:
    path = find_browser()
    if path is None:
        assert not os.environ.get(EXPECT), (
            "no browser, and this machine must have one: tools/installation/install_browser.sh"
        )
        pytest.skip("NO BROWSER HERE, THE LIVE PAGE IS NOT TESTED: run tools/installation/install_browser.sh")
    return path


def text(tab: Tab, name: str) -> str:
    return str(tab.evaluate(f"document.getElementById('{name}').textContent"))


def test_an_operator_stops_a_run_and_clears_the_drive(
    drive: DriveFixture, run: RunFixture, pty_wire: Any, tmp_path: Path
) -> None:
    path, out = browser_path(), tmp_path / "out"
    other = drive(pty_wire)
    service = run(pty_wire, out, "--live", "--live-control", "--duration", "600")
    with browser(path) as tab:
        tab.open(address_of(service))
        tab.wait("document.getElementById('stage').textContent === 'running'")
        tab.wait("live.frames > 10")
        assert text(tab, "drive") == "drive operational"
        tab.evaluate("document.getElementById('stop').click()")
        tab.wait("document.getElementById('stage').textContent === 'stopped'")
        tab.wait("document.getElementById('drive').textContent === 'drive fault'")
        assert "stopped by an operator" in text(tab, "banner")
        assert "ESTOP" in text(tab, "banner")
        rows = tab.evaluate("live.store.streams[0].rows")
        tab.wait(f"live.store.streams[0].rows > {rows + 50}")  # the jaw is still seen
        assert service.process.poll() is None
        tab.evaluate("document.getElementById('clear').click()")
        tab.wait("document.getElementById('stage').textContent === 'ended'")
        assert "cleared" in text(tab, "banner")
        assert not tab.errors
    ended = service.end()
    told = other.end(signal.SIGTERM).told
    result = json.loads((out / "run.json").read_text())
    assert ended.code == 2
    assert (result["reason"], result["drive_disabled"]) == ("emergency_stop", True)
    assert result["message"] == "stopped by an operator; cleared"
    assert (out / "fault.json").exists()
    assert (told["drive"]["state"], told["drive"]["faults"]) == ("DISABLED", 1)


def test_a_drive_shows_what_really_is(start: Any, pty_wire: Any) -> None:
    path = browser_path()
    other = start("drive", "--rig", PAPER, *pty_wire.drive, "--live")
    address = address_of(other)
    assert other.first_line().startswith("ready ")
    with browser(path) as tab:
        tab.open(address)
        tab.wait("window.live && live.store.newest > 1 && live.frames > 5")
        tab.wait("document.getElementById('drive').textContent === 'drive disabled'")
        assert tab.evaluate("live.store.streams[0].value('theta_j_rad', live.view[1])") == pytest.approx(
            np.pi / 2, abs=0.1
        )
        assert not tab.errors
    assert other.end(signal.SIGTERM).told["drive"]["state"] == "DISABLED"


# -- what it costs ----------------------------------------------------------------------------------------------------

AT_1_KHZ = "HIL_FORCEPS_LIVE_1KHZ"  # for a figure on a quiet machine; a busy one meets the drive's watchdog of 20 ms
SWITCH_S = 2.0  # short and often, so that what else the machine does falls on both alike
SWITCHES = 24
WARM_UP_S = 1.0  # behind each switch: loading the page is not having it open


def ages_ns(recording: Recording) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Return time of each reference that was sent, and its age, counted as the service does.

    Not by one offset of the clocks for the whole run: a simulated drive that stalled leaves the stall out of its time.
    """
    sent = recording.references[recording.references["outcome"] == 1]
    samples = zip(recording.samples["stamp_ns"].tolist(), recording.samples["received_ns"].tolist(), strict=True)
    stamps, ages = StampMap(), []
    following = next(samples, None)
    for stamp_ns, sent_ns in zip(sent["stamp_ns"].tolist(), sent["sent_ns"].tolist(), strict=True):
        while following is not None and following[0] <= stamp_ns:
            stamps.see(*following)
            following = next(samples, None)
        ages.append(sent_ns - stamps.host_time_ns(stamp_ns))
    return sent["tick_ns"], np.array(ages)


# On two cores the ratio was 1.07 to 2.5: the requirement is not met there (docs/live.md), so this is a figure to take
# on a machine with cores to spare, with the bound as required.
@pytest.mark.skipif(not os.environ.get(AT_1_KHZ), reason=f"{AT_1_KHZ} is not set: for a machine with cores to spare")
def test_an_open_page_makes_no_reference_older(
    drive: DriveFixture, run: RunFixture, pty_wire: Any, tmp_path: Path, record_property: Any
) -> None:
    """In one run, by turns: p99 of the age with the page open is at most 1.1 times that without."""
    path, out = browser_path(), tmp_path / "out"
    other = drive(pty_wire, rig=PAPER)
    service = run(pty_wire, out, "--live", "--duration", "600", rig=PAPER)
    phases: list[tuple[bool, int, int]] = []
    with browser(path) as tab:
        address = address_of(service)
        tab.open(address)
        tab.wait("document.getElementById('stage')?.textContent === 'running'")
        for number in range(SWITCHES):
            is_open = number % 2 == 0
            tab.open("about:blank")
            if is_open:
                tab.open(address)
                tab.wait("window.live && live.frames > 3")
            time.sleep(WARM_UP_S)
            began_ns = time.monotonic_ns()
            time.sleep(SWITCH_S)
            if is_open:
                assert tab.evaluate("live.head.lost + live.lostInChannel + live.head.enveloped") == 0
            phases.append((is_open, began_ns, time.monotonic_ns()))
    ended = service.end(signal.SIGTERM)
    other.end(signal.SIGTERM)
    assert ended.code == 0, ended.err
    ticks, ages = ages_ns(read_recording(out / "run.mcap"))
    parts = {
        which: np.concatenate(
            [ages[(ticks >= begin) & (ticks < end)] for is_open, begin, end in phases if is_open is which]
        )
        for which in (True, False)
    }
    assert min(map(len, parts.values())) > 500
    p50, p99 = ({which: np.percentile(part, share) for which, part in parts.items()} for share in (50, 99))
    sys.stdout.write(f"age open/closed: p50 {p50[True] / 1e3:.0f}/{p50[False] / 1e3:.0f} µs, "
          f"p99 {p99[True] / 1e3:.0f}/{p99[False] / 1e3:.0f} µs, ratio {p99[True] / p99[False]:.3f}\n")  # fmt: skip
    record_property("p99_open_over_closed", p99[True] / p99[False])
    assert p99[True] <= 1.1 * p99[False]


# -- Foxglove ---------------------------------------------------------------------------------------------------------


def test_foxglove_gets_the_topics_of_a_recording(
    drive: DriveFixture, run: RunFixture, pty_wire: Any, tmp_path: Path
) -> None:
    pytest.importorskip("foxglove")
    out = tmp_path / "out"
    other = drive(pty_wire)
    service = run(pty_wire, out, "--live", "--foxglove", "--duration", "600")
    address = foxglove_of(service)
    assert re.fullmatch(r"ws://127\.\d+\.\d+\.\d+:\d+", address)
    channels, messages = asyncio.run(foxglove_rows(address, 200))
    service.end(signal.SIGTERM)
    other.end(signal.SIGTERM)
    recording = read_recording(out / "run.mcap")
    assert set(channels) == {"/sample", "/reference", "/bench", "/tick"}
    assert channels["/sample"]["schemaName"] == "hil_forceps/msg/Sample"
    assert (channels["/sample"]["encoding"], channels["/sample"]["schemaEncoding"]) == ("cdr", "ros2msg")
    recorded = {row.tobytes() for row in recording.samples}
    assert len(messages) == 200
    assert all(body[:4] == b"\x00\x01\x00\x00" and body[4:] in recorded for body in messages)  # bit by bit


def foxglove_of(command: Any) -> str:
    for line in iter(command.process.stderr.readline, ""):
        if found := re.search(r"Foxglove: open a connection to (\S+)", line):
            return found[1]
    raise AssertionError(command.end())


async def foxglove_rows(address: str, count: int) -> tuple[dict[str, dict[str, Any]], list[bytes]]:
    """Speak Foxglove's protocol as far as it takes: subscribe to /sample and take messages."""
    channels: dict[str, dict[str, Any]] = {}
    messages: list[bytes] = []
    async with connect_async(address, subprotocols=["foxglove.sdk.v1"], max_size=None) as client:  # type: ignore[list-item]
        async with asyncio.timeout(60):
            while len(messages) < count:
                told = await client.recv()
                if isinstance(told, str):
                    message = json.loads(told)
                    if message["op"] == "advertise":
                        channels |= {each["topic"]: each for each in message["channels"]}
                        wanted = [{"id": 1, "channelId": channels["/sample"]["id"]}] if "/sample" in channels else []
                        await client.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
                elif told[0] == 1:  # opcode, subscription, log time, message
                    messages.append(told[13:])
    return channels, messages
