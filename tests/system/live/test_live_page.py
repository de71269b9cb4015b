"""The live page in a real browser, and whoever else comes to its port."""

import json
import os
import socket
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin

from hil_forceps.live.history import MAX_BACKLOG_S
from hil_forceps.live.view import LiveOptions, live_view
from hil_forceps.rig.errors import UserError
from tests.system.live.browser import Tab, browser, find_browser
from tests.system.live.live_producer import HOSTILE, Produced, described, produced

pytestmark = [pytest.mark.realtime, pytest.mark.alone, pytest.mark.slow]

EXPECT = "HIL_FORCEPS_EXPECT_BROWSER"  # set where a browser has to be there: then its absence fails
ROWS = "live.store.streams[0].rows"


@pytest.fixture(scope="module")
def tab() -> Iterator[Tab]:
    path = find_browser()
    if path is None:
        assert not os.environ.get(EXPECT), (
            "no browser, and this machine must have one: tools/installation/install_browser.sh"
        )
        pytest.skip("NO BROWSER HERE, THE LIVE PAGE IS NOT TESTED: run tools/installation/install_browser.sh")
    with browser(path) as opened:
        opened.size(1280, 800)
        yield opened
        assert not [error for error in opened.errors if "ERR_CONNECTION_REFUSED" not in error]


@pytest.fixture(scope="module")
def source() -> Iterator[Produced]:
    with produced() as made:
        yield made


def opened(tab: Tab, source: Produced, frames: int = 5) -> Tab:
    tab.open("about:blank")
    tab.open(source.address)
    tab.wait(f"window.live && live.frames > {frames}")
    return tab


def pixels(tab: Tab) -> list[int]:
    """Return how many pixels of each plot have a curve's colour: neither grey nor clear."""
    script = """live.panels.map(({chart}) => {
      const {width, height} = chart.ctx.canvas;
      const data = chart.ctx.getImageData(0, 0, width, height).data;
      let seen = 0;
      for (let at = 0; at < data.length; at += 4) {
        if (Math.max(data[at], data[at+1], data[at+2]) - Math.min(data[at], data[at+1], data[at+2]) > 80
            && data[at+3] > 128) seen += 1;
      }
      return seen;
    })"""
    found: list[int] = tab.evaluate(script)
    return found


# -- the page ---------------------------------------------------------------------------------------------------------


def test_it_opens_and_draws_every_signal(tab: Tab, source: Produced) -> None:
    opened(tab, source)
    assert tab.evaluate("document.title") == "producer – live"
    tab.wait(f"{ROWS} > 1000")
    tab.wait("live.frames > 20")
    assert len(pixels(tab)) == 4
    assert min(pixels(tab)) > 500
    texts = tab.evaluate("[...document.querySelectorAll('.key output')].map((each) => each.textContent)")
    assert len(texts) == 9
    assert "–" not in texts
    assert tab.evaluate("document.getElementById('stage').textContent") == "running"
    assert tab.evaluate("location.href") == f"http://{source.host}/"  # the token is nowhere to be seen


def test_every_row_of_eight_signals_at_1_kHz_arrives(tab: Tab, source: Produced) -> None:
    opened(tab, source)
    before = tab.evaluate(ROWS)
    tab.wait(f"{ROWS} > {before + 4000}")
    told = tab.evaluate(
        """(() => { const s = live.store.streams[0]; const t = s.columns[0]; let steps = 0;
        for (let row = 1; row < s.rows; row += 1) if (Math.abs(t[row] - t[row-1] - 1e-3) > 1e-7) steps += 1;
        let wrong = 0;
        for (let row = 0; row < s.rows; row += 1) for (const name of ["s1", "s3", "s5", "s7"])
          if (s.column(name)[row] !== Math.round(1e3 * t[row])) wrong += 1;
        return {steps, wrong, rows: s.rows,
          lost: live.lostInChannel + live.head.lost, thin: live.head.enveloped}; })()"""
    )
    assert told["rows"] > 4000
    assert (told["steps"], told["wrong"], told["lost"], told["thin"]) == (0, 0, 0, 0)


def test_a_reload_finds_the_run_again_with_what_was_before(tab: Tab, source: Produced) -> None:
    opened(tab, source)
    tab.wait(f"{ROWS} > 2000")
    tab.evaluate("window.isOld = true")
    tab.call("Page.reload")
    tab.wait("!window.isOld && window.live && live.frames > 3")
    tab.wait(f"{ROWS} > 2000")
    assert tab.evaluate("document.getElementById('link').className") == "dot ok"
    assert tab.evaluate("live.head.lost + live.lostInChannel") == 0


def test_pause_holds_the_view_and_loses_nothing(tab: Tab, source: Produced) -> None:
    opened(tab, source)
    tab.evaluate("document.getElementById('pause').click()")
    view, rows = tab.evaluate("live.view"), tab.evaluate(ROWS)
    tab.wait(f"{ROWS} > {rows + 500}")
    assert tab.evaluate("live.view") == view
    tab.evaluate("document.getElementById('pause').click()")
    tab.wait(f"live.view[1] > {view[1] + 0.5}")


def test_cursors_tell_values_and_differences(tab: Tab, source: Produced) -> None:
    opened(tab, source)
    tab.wait(f"{ROWS} > 3000")
    tab.evaluate("document.getElementById('cursors').click()")
    tab.evaluate("live.cursors = [live.view[1] - 2.0, live.view[1] - 0.5]; live.redraw()")
    tab.wait("document.querySelector('#values tbody td')?.textContent !== '–'")
    rows = tab.wait(
        """(() => { const rows = [...document.querySelectorAll('#values tbody tr')].map((row) =>
        [...row.children].map((cell) => cell.textContent)); return rows[0][3].startsWith('1.5') && rows; })()"""
    )
    assert rows[0][0] == "time [s]"
    counts = [float(cell) for cell in rows[2][1:]]  # s1 counts milliseconds
    assert counts[2] == pytest.approx(1500, abs=1.5)
    assert counts[1] - counts[0] == pytest.approx(counts[2], abs=1.5)
    tab.evaluate("document.getElementById('cursors').click()")


def test_a_drag_zooms_and_a_double_click_goes_back(tab: Tab, source: Produced) -> None:
    opened(tab, source)
    tab.wait(f"{ROWS} > 3000")
    box = tab.evaluate(
        "(({left, top, width}) => [left, top, width])(live.panels[0].chart.over.getBoundingClientRect())"
    )
    left, y = box[0] + 0.6 * box[2], box[1] + 20
    for kind, x in (
        ("mouseMoved", left),
        ("mousePressed", left),
        ("mouseMoved", left + 90),
        ("mouseReleased", left + 90),
    ):
        tab.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1)
    tab.wait("live.isPaused && live.view[1] - live.view[0] < 3")
    tab.evaluate("live.panels[0].chart.over.dispatchEvent(new MouseEvent('dblclick', {bubbles: true}))")
    tab.wait("!live.isPaused && live.view[1] - live.view[0] > 9")


def test_what_is_exported_is_what_was_written(tab: Tab, source: Produced, tmp_path: Path) -> None:
    opened(tab, source)
    tab.wait(f"{ROWS} > 3000")
    tab.call("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path))
    tab.evaluate("document.getElementById('pause').click()")
    tab.evaluate("live.cursors = [live.view[1] - 1.0, live.view[1] - 0.5]; document.getElementById('csv').click()")
    tab.evaluate("document.getElementById('png').click()")
    end = time.monotonic() + 30
    while len(found := [path for path in tmp_path.iterdir() if path.suffix in {".csv", ".png"}]) < 2:
        assert time.monotonic() < end
        time.sleep(0.05)
    tab.evaluate("live.cursors = null")
    table, picture = sorted(found, key=lambda path: path.suffix)
    names, *lines = table.read_text().splitlines()
    assert names == "time_s,s0,s1,s2,s3,s4,s5,s6,s7"
    assert 495 <= len(lines) <= 505
    for line in lines:
        cells = [float(cell) for cell in line.split(",")]
        assert cells[2] == cells[4] == round(1e3 * cells[0])
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_light_and_dark_and_every_width_draw(tab: Tab, source: Produced) -> None:
    opened(tab, source)
    for width, height, dark in ((1920, 1080, True), (1024, 768, False), (480, 900, True)):
        tab.size(width, height, dark=dark)
        tab.wait(f"document.documentElement.classList.contains('dark') === {str(dark).lower()}")
        frames = tab.evaluate("live.frames")
        tab.wait(f"live.frames > {frames + 4}")
        assert min(pixels(tab)) > 200
        assert tab.evaluate("document.documentElement.scrollWidth <= innerWidth")
    tab.size(1280, 800)


def test_no_text_of_the_data_is_markup_or_script(tab: Tab) -> None:
    with produced(HOSTILE, control=True) as source:
        opened(tab, source)
        tab.wait(f"{ROWS} > 1000")
        tab.wait("document.querySelectorAll('#counters h3').length > 1")
        assert tab.evaluate("window.bad === undefined")
        assert tab.evaluate("document.querySelectorAll('img, iframe, object').length") == 0
        assert tab.evaluate(
            "[...document.scripts].map((each) => each.src).every((each) => each.startsWith(location.origin))"
        )
        assert HOSTILE in tab.evaluate("document.getElementById('title').textContent")
        assert HOSTILE in tab.evaluate("document.getElementById('banner').textContent")
        # And where some did become markup, the policy lets none of it run.
        with pytest.raises(AssertionError, match="TrustedHTML"):
            tab.evaluate("document.body.innerHTML = '<b>x</b>'")
        assert not tab.evaluate("fetch('http://127.0.0.1:9/').then(() => 'left', (error) => error.message)").startswith(
            "left"
        )
        tab.errors.clear()  # which the browser said of the last two


def test_stop_and_clear_are_there_with_control_only(tab: Tab, source: Produced) -> None:
    opened(tab, source)
    assert tab.evaluate("document.getElementById('control').hidden")
    with produced(control=True) as made:
        opened(tab, made)
        assert not tab.evaluate("document.getElementById('control').hidden")
        assert tab.evaluate("document.getElementById('clear').disabled")
        assert not made.memory_writer.stop_asked()
        tab.evaluate("document.getElementById('stop').click()")
        tab.wait("document.getElementById('stage').textContent === 'stopped'")
        assert made.memory_writer.stop_asked()
        tab.wait("!document.getElementById('clear').disabled")
        tab.evaluate("document.getElementById('clear').click()")
        end = time.monotonic() + 30
        while made.memory_writer.clears_asked() != 1 and time.monotonic() < end:
            time.sleep(0.02)
        assert made.memory_writer.clears_asked() == 1


def test_the_end_of_the_run_leaves_the_page_with_its_data(tab: Tab) -> None:
    with produced() as made:
        opened(tab, made)
        tab.wait(f"{ROWS} > 1000")
        made.producer.stop()
        rows = made.producer.rows
    tab.wait("document.getElementById('stage').textContent === 'ended'")
    assert tab.evaluate(f"{ROWS} + live.head.lost") == rows  # down to the last one
    assert min(pixels(tab)) > 200


# -- slow clients -----------------------------------------------------------------------------------------------------


def test_a_client_that_does_not_read_holds_up_nobody_and_is_told_what_it_missed() -> None:
    with produced() as source:
        host, port = source.host.split(":")
        slow = socket.socket()
        slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 12)
        slow.connect((host, int(port)))
        with source.client(sock=slow) as lazy, source.client() as quick:
            rows, head = rows_of(quick, 9_000)
            assert rows[-1] - rows[0] == len(rows) - 1  # every row, in order
            assert (head["enveloped"], head["lost"]) == (0, 0)
            heads = heads_of(lazy, 400)
    assert any(part["stands_for"] > MAX_BACKLOG_S * 1000 for head in heads for part in head["parts"])
    assert heads[-1]["enveloped"] > 0


def rows_of(client: Any, count: int) -> tuple[list[int], dict[str, Any]]:
    """Read until enough rows have come; return their numbers and the last head."""
    seen: list[int] = []
    head: dict[str, Any] = {}
    while len(seen) < count:
        message = client.recv(60)
        if isinstance(message, bytes):
            length = int.from_bytes(message[4:8], "little")
            head = json.loads(message[8 : 8 + length])
            (part,) = head["parts"]
            times = memoryview(message[8 + length :]).cast("d")[: part["rows"]]
            seen += [round(1e3 * t) for t in times]
    return seen, head


def heads_of(client: Any, count: int) -> list[dict[str, Any]]:
    """Read messages until one stands for rows that were left out, `count` at most; return their heads."""
    heads: list[dict[str, Any]] = []
    for _ in range(count):
        message = client.recv(60)
        if isinstance(message, bytes):
            length = int.from_bytes(message[4:8], "little")
            heads.append(json.loads(message[8 : 8 + length]))
            if heads[-1]["enveloped"]:
                break
    return heads


# -- who gets in ------------------------------------------------------------------------------------------------------


def status_of(source: Produced, path: str, **headers: str) -> int:
    request = urllib.request.Request(f"http://{source.host}{path}", headers=headers)
    try:
        with urllib.request.urlopen(request, timeout=30) as answer:
            return int(answer.status)
    except urllib.error.HTTPError as error:
        return error.code


def test_it_listens_on_loopback_alone(source: Produced) -> None:
    port = int(source.host.rpartition(":")[2])
    listening = [
        line.split()[1]
        for name in ("tcp", "tcp6")
        for line in Path(f"/proc/net/{name}").read_text().splitlines()[1:]
        if line.split()[3] == "0A" and line.split()[1].endswith(f":{port:04X}")
    ]
    assert listening == [f"0100007F:{port:04X}"]


def test_files_of_the_page_and_nothing_else(source: Produced) -> None:
    for path in ("/", "/main.js", "/style.css", "/uplot/uPlot.iife.min.js", "/uplot/LICENSE"):
        assert status_of(source, path) == 200
    for path in ("/server.py", "/../server.py", "/%2e%2e/server.py", "/uplot/", "//etc/passwd", "/live.js"):
        assert status_of(source, path) == 404
    assert status_of(source, "/", Host="evil.example") == 421


def test_the_page_may_load_nothing_from_elsewhere(source: Produced) -> None:
    with urllib.request.urlopen(f"http://{source.host}/", timeout=30) as answer:
        policy = dict(each.strip().partition(" ")[::2] for each in answer.headers["Content-Security-Policy"].split(";"))
        body = answer.read().decode()
    assert policy["default-src"] == "'none'"
    assert policy["script-src"] == policy["style-src"] == "'self'"
    assert policy["connect-src"] == f"'self' ws://{source.host}"
    assert policy["require-trusted-types-for"] == "'script'"
    assert "http:" not in body
    assert "https:" not in body


@pytest.mark.parametrize("origin", [None, "null", "http://evil.example", "http://localhost:1"])
def test_a_socket_from_another_page_is_refused(source: Produced, origin: Any) -> None:
    with pytest.raises(InvalidStatus) as refused, source.client(origin=origin):
        pass
    assert refused.value.response.status_code == 403


def test_a_rebound_name_is_refused(source: Produced) -> None:
    evil = Origin("http://evil.example")
    more = {"Host": "evil.example"}
    with pytest.raises(InvalidStatus) as refused:
        connect(f"ws://{source.host}/live", origin=evil, additional_headers=more)
    assert refused.value.response.status_code in {400, 421}


@pytest.mark.parametrize("token", ["none", "", "x" * 43, b"bytes"])
def test_without_the_token_nothing_is_told(source: Produced, token: Any) -> None:
    page = Origin(f"http://{source.host}")
    with connect(f"ws://{source.host}/live", origin=page) as client:
        client.send(token)
        with pytest.raises(ConnectionClosed) as closed:
            client.recv(30)
    assert closed.value.rcvd is not None
    assert closed.value.rcvd.code == 4401


def test_what_a_page_without_control_asks_for_is_not_heard(source: Produced) -> None:
    with source.client() as client:
        for message in ("stop", "clear", '{"kind":"stop"}', b"stop", "x" * 1000):
            client.send(message)
        rows_of(client, 500)
    assert not source.memory_writer.stop_asked()
    assert source.memory_writer.clears_asked() == 0


def test_a_client_that_sends_too_much_is_dropped_and_others_are_not(source: Produced) -> None:
    with source.client() as polite:
        with source.client() as rude:
            rude.send("x" * 100_000)
            with pytest.raises(ConnectionClosed):
                rows_of(rude, 1 << 30)
        rows, _ = rows_of(polite, 1000)
    assert rows[-1] - rows[0] == len(rows) - 1


def test_an_address_that_can_not_be_had_is_told() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        options = LiveOptions(port=taken.getsockname()[1])
        with pytest.raises(UserError, match="Address already in use"), live_view(described(), options):
            pass
    elsewhere = live_view(described(), LiveOptions(host="203.0.113.1"))
    with pytest.raises(UserError, match=r"can't be served at 203.0.113.1:0: Cannot assign"), elsewhere:
        pass
