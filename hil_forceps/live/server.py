"""The server of the live page: files over HTTP, data over a websocket for clients with the token.

Every client has its own task, which waits until its socket accepts the next frame. A slow client therefore delays
neither the loop, which is another process, nor other clients; its data are thinned (`history`).
"""

import asyncio
import json
import socket
from collections.abc import Callable
from contextlib import suppress
from http import HTTPStatus
from importlib.resources import files
from typing import Any, Final

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from hil_forceps.live.access import POLICY, is_our_host, is_our_page, is_token, names_of
from hil_forceps.live.channel import Operator
from hil_forceps.live.history import Cursor, History

FRAME_S: Final = 1.0 / 30.0
TOKEN_TIMEOUT_S: Final = 5.0
MAX_CLIENTS: Final = 16
MAX_MESSAGE_BYTES: Final = 1 << 10
SEND_BUFFER_BYTES: Final = 1 << 16  # limits the data queued for a slow client
CLOSE_WRONG_TOKEN: Final = 4401
CLOSE_FULL: Final = 4503
SOCKET_PATH: Final = "/live"
PAGE_FILES: Final = {
    "/": ("index.html", "text/html; charset=utf-8"),
    "/style.css": ("style.css", "text/css; charset=utf-8"),
    "/uplot/uPlot.min.css": ("uplot/uPlot.min.css", "text/css; charset=utf-8"),
    "/uplot/uPlot.iife.min.js": ("uplot/uPlot.iife.min.js", "text/javascript; charset=utf-8"),
    "/uplot/LICENSE": ("uplot/LICENSE", "text/plain; charset=utf-8"),
    **{
        f"/{name}.js": (f"{name}.js", "text/javascript; charset=utf-8")
        for name in ("main", "store", "scope", "lanes", "side", "export", "link")
    },
}


class LiveServer:
    """Server of one run. `told`: first message to the page; `operator` is None if the page has no control."""

    def __init__(self, history: History, told: dict[str, Any], token: str, operator: Operator | None) -> None:
        self._history = history
        self._told = {**told, "kind": "hello", "control": operator is not None}
        self._token = token
        self._operator = operator
        self._clients: set[ServerConnection] = set()
        self._news = asyncio.Event()
        self._status: Any = None
        self._lost = 0
        self._has_ended = False
        self._names: frozenset[str] = frozenset()
        self._page = _load_page()
        self.counters = {"refused": 0, "clients": 0, "stops": 0, "clears": 0}

    async def start(self, host: str, port: int) -> tuple[Server, int]:
        """Listen; return the server and its port. OSError if the address can't be bound."""
        listening = socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)  # accepted ones take it over
        number = int(listening.getsockname()[1])
        self._names = names_of(host, number)
        server = await serve(
            self._client,
            sock=listening,
            process_request=self._answer,
            compression=None,  # costs more than it saves on loopback
            max_size=MAX_MESSAGE_BYTES,
            server_header=None,
        )
        return server, number

    def publish(self, status: Any | None, lost: int, *, has_ended: bool = False) -> None:
        """Notify the clients of new rows and of the changed status."""
        if status is not None:
            self._status = status
        self._lost = lost
        self._has_ended = has_ended
        news, self._news = self._news, asyncio.Event()
        news.set()

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Return a file of the page, or None to accept a websocket."""
        host = _only(request.headers, "Host")
        if not is_our_host(host, self._names):
            return self._refuse(
                connection, HTTPStatus.MISDIRECTED_REQUEST, "the host name is not that of this server\n"
            )
        path = request.path.partition("?")[0]
        if path == SOCKET_PATH:
            if not is_our_page(_only(request.headers, "Origin"), host):
                return self._refuse(connection, HTTPStatus.FORBIDDEN, "only the live page may open this connection\n")
            return None
        if path not in self._page:
            return self._refuse(connection, HTTPStatus.NOT_FOUND, "no such page\n")
        kind, body = self._page[path]
        headers = Headers()
        headers["Content-Type"] = kind
        headers["Content-Length"] = str(len(body))
        headers["Content-Security-Policy"] = POLICY.format(socket=f"ws://{host}")
        headers["X-Content-Type-Options"] = "nosniff"
        headers["Referrer-Policy"] = "no-referrer"
        headers["Cross-Origin-Resource-Policy"] = "same-origin"
        headers["Cross-Origin-Opener-Policy"] = "same-origin"
        headers["Cache-Control"] = "no-cache"
        headers["Connection"] = "close"
        return Response(HTTPStatus.OK, "OK", headers, body)

    def _refuse(self, connection: ServerConnection, status: HTTPStatus, words: str) -> Response:
        self.counters["refused"] += 1
        return connection.respond(status, words)

    async def _client(self, connection: ServerConnection) -> None:
        if len(self._clients) >= MAX_CLIENTS:
            await connection.close(CLOSE_FULL, "too many pages are open")
            return
        self._clients.add(connection)
        try:
            if not await self._has_token(connection):
                self.counters["refused"] += 1
                await connection.close(CLOSE_WRONG_TOKEN, "wrong token; open the address that the run printed")
                return
            self.counters["clients"] += 1
            await connection.send(json.dumps(self._told))
            listening = asyncio.create_task(self._listen(connection))
            try:
                await self._feed(connection)
            finally:
                listening.cancel()
                with suppress(asyncio.CancelledError, ConnectionClosed):
                    await listening
        except ConnectionClosed:
            pass
        finally:
            self._clients.discard(connection)

    async def _has_token(self, connection: ServerConnection) -> bool:
        try:
            given = await asyncio.wait_for(connection.recv(), TOKEN_TIMEOUT_S)
        except TimeoutError:
            return False
        return is_token(given, self._token)

    async def _feed(self, connection: ServerConnection) -> None:
        cursor = Cursor(self._history)
        told_status: Any = None
        told_lost = -1
        while True:
            news, has_ended = self._news, self._has_ended
            while (frame := cursor.frame()) is not None:
                await connection.send(frame)
            if self._status is not told_status or self._lost != told_lost:
                told_status, told_lost = self._status, self._lost
                await connection.send(json.dumps({"kind": "status", "status": told_status, "lost": told_lost}))
            if has_ended:
                await connection.send(json.dumps({"kind": "end"}))
                await connection.close(1000, "the run has ended")
                return
            await news.wait()

    async def _listen(self, connection: ServerConnection) -> None:
        """Receive the operator's requests; anything else is dropped."""
        asked: dict[str, Callable[[], None]] = {"stop": self._stop, "clear": self._clear}
        async for message in connection:
            action = asked.get(message) if isinstance(message, str) else None
            if action is not None:
                action()

    def _stop(self) -> None:
        if self._operator is not None:
            self.counters["stops"] += 1
            self._operator.stop()

    def _clear(self) -> None:
        if self._operator is not None:
            self.counters["clears"] += 1
            self._operator.clear()


def _only(headers: Headers, name: str) -> str | None:
    """Return a header that occurs once; None if it is missing or occurs several times."""
    values = headers.get_all(name)
    return values[0] if len(values) == 1 else None


def _load_page() -> dict[str, tuple[str, bytes]]:
    folder = files("hil_forceps.live") / "page"
    return {path: (kind, folder.joinpath(name).read_bytes()) for path, (name, kind) in PAGE_FILES.items()}
