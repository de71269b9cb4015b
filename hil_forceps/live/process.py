"""The process of the live page: reads the channel, serves the page, and ends with its parent.

Its parent passes the channel as an open file, and on standard input a line of JSON with the settings and one with the
description. It answers with a line on standard output, `ready ADDRESS` or `failed WORDS`. Standard input is the signal
of the end: when it closes, the run has ended, for whatever reason.
"""

import argparse
import asyncio
import json
import mmap
import os
import signal
import sys
from typing import Any, Final

from hil_forceps.live.channel import Operator, Reader
from hil_forceps.live.description import Description, for_page, from_json
from hil_forceps.live.history import History
from hil_forceps.live.server import FRAME_S, LiveServer

NICENESS: Final = 10  # the loop has priority
LINGER_S: Final = 3.0  # time for pages to receive the last frames


async def _read(reader: Reader, history: History, server: LiveServer, foxglove: Any, ended: asyncio.Event) -> None:
    lost = 0
    while True:
        is_last = ended.is_set()
        taken = reader.take()
        while len(taken.slots):
            lost += taken.lost
            history.add(taken.slots)
            if foxglove is not None:
                foxglove.send(taken.slots)
            taken = reader.take()
        lost += taken.lost
        server.publish(reader.status(), lost + history.not_understood, has_ended=is_last)
        if is_last:
            return
        await asyncio.sleep(FRAME_S)


async def _serve(settings: dict[str, Any], description: Description, memory: mmap.mmap) -> None:
    history = History(description)
    operator = Operator(memory) if settings["control"] else None
    server = LiveServer(history, for_page(description), settings["token"], operator)
    foxglove = None
    try:
        listening, port = await server.start(settings["host"], settings["port"])
        if settings["foxglove"]:
            from hil_forceps.live.foxglove import FoxgloveServer  # noqa: PLC0415 - an optional extra

            foxglove = FoxgloveServer(description)
    except ImportError:
        _say("failed Foxglove's SDK isn't installed; pip install 'hil-forceps[foxglove]'")
        return
    except (OSError, RuntimeError) as error:
        _say(f"failed {getattr(error, 'strerror', None) or error}")
        return
    ended = asyncio.Event()
    loop = asyncio.get_running_loop()
    loop.add_reader(sys.stdin.fileno(), lambda: ended.set() if not os.read(sys.stdin.fileno(), 1 << 12) else None)
    _say(f"ready {port} {foxglove.address if foxglove is not None else 0}")
    await _read(Reader(memory), history, server, foxglove, ended)
    loop.remove_reader(sys.stdin.fileno())
    listening.close(close_connections=False)
    try:
        await asyncio.wait_for(listening.wait_closed(), LINGER_S)
    except TimeoutError:
        listening.close()
    if foxglove is not None:
        foxglove.close()


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def _line() -> str:
    """Return a line of standard input without buffering, because the loop waits for what follows."""
    taken = bytearray()
    while (byte := os.read(sys.stdin.fileno(), 1)) not in {b"", b"\n"}:
        taken += byte
    return taken.decode()


def main() -> int:
    """Run the process."""
    parser = argparse.ArgumentParser(prog="hil_forceps.live.process")
    parser.add_argument("descriptor", type=int, help="of the channel's memory")
    arguments = parser.parse_args()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # the parent ends this process
    os.nice(NICENESS)
    settings = json.loads(_line())
    description = from_json(_line())
    memory = mmap.mmap(arguments.descriptor, 0)
    os.close(arguments.descriptor)
    asyncio.run(_serve(settings, description, memory))
    return 0


if __name__ == "__main__":
    sys.exit(main())
