"""Start and end of the live page's process."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Final, NamedTuple

from hil_forceps.live.access import LOOPBACK, is_loopback, new_token, parse_address
from hil_forceps.live.channel import Writer, create
from hil_forceps.live.description import Description, to_json
from hil_forceps.rig.errors import UserError

END_TIMEOUT_S: Final = 10.0


class LiveOptions(NamedTuple):
    """Options of the live page. `control`: the page can stop the drive. Port 0: any free port."""

    host: str = LOOPBACK
    port: int = 0
    control: bool = False
    foxglove: bool = False


def live_options(*, live: bool, control: bool, bind: str, foxglove: bool) -> LiveOptions | None:
    """Return the options of the live page, None without one; UserError for options that need `--live`."""
    if not live:
        wanting = {"--live-control": control, "--live-bind": bool(bind), "--foxglove": foxglove}
        if extra := [name for name, is_given in wanting.items() if is_given]:
            raise UserError(f"{extra[0]}: only with --live; add it, or leave {extra[0]} out")
        return None
    host, port = parse_address(bind, "--live-bind") if bind else (LOOPBACK, 0)
    return LiveOptions(host, port, control, foxglove)


class View(NamedTuple):
    """A live page that is being served. Only clients with `address` get data."""

    writer: Writer
    address: str
    foxglove_address: str  # empty if not requested
    options: LiveOptions

    def notes(self) -> list[str]:
        """Return notes for the user."""
        told = [f"live page: {self.address}"]
        if not is_loopback(self.options.host):
            told.append(f"the live page is reachable from the network at {self.options.host}, without encryption")
        if self.foxglove_address:
            told.append(f"Foxglove: open a connection to {self.foxglove_address}")
        return told


@contextmanager
def live_view(description: Description, options: LiveOptions) -> Iterator[View]:
    """Serve a page in a separate process while the block runs; UserError if that is not possible."""
    descriptor, memory = create()
    token = new_token()
    process = subprocess.Popen(  # noqa: S603 - this interpreter and this package, no shell
        [sys.executable, "-m", "hil_forceps.live.process", str(descriptor)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        pass_fds=(descriptor,),
        text=True,
        start_new_session=True,  # Ctrl-C ends the run, which ends the page
    )
    os.close(descriptor)
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        settings = {**options._asdict(), "token": token}
        with suppress(BrokenPipeError):  # its answer has the reason
            process.stdin.write(f"{json.dumps(settings)}\n{to_json(description)}\n")
            process.stdin.flush()
        word, _, rest = process.stdout.readline().strip().partition(" ")
        if word != "ready":
            why = rest or "its process ended without a message"
            raise UserError(f"--live: the page can't be served at {options.host}:{options.port}: {why}")
        port, foxglove = rest.split(" ", 1)
        host = f"[{options.host}]" if ":" in options.host else options.host
        yield View(
            Writer(memory),
            f"http://{host}:{port}/#{token}",
            "" if foxglove == "0" else f"ws://{foxglove}",
            options,
        )
    finally:
        with suppress(BrokenPipeError):
            process.stdin.close()
        try:
            process.wait(END_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        process.stdout.close()
        memory.close()
