"""Starting and ending the page's process beside a loop."""

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
    """How a run is shown. `control`: who has the page may stop the drive. Port 0: one that is free."""

    host: str = LOOPBACK
    port: int = 0
    control: bool = False
    foxglove: bool = False


def live_options(*, live: bool, control: bool, bind: str, foxglove: bool) -> LiveOptions | None:
    """Return how a run is to be shown, None for not at all; UserError for options that want `--live`."""
    if not live:
        wanting = {"--live-control": control, "--live-bind": bool(bind), "--foxglove": foxglove}
        if extra := [name for name, is_given in wanting.items() if is_given]:
            raise UserError(f"{extra[0]}: only with --live; add it, or leave {extra[0]} out")
        return None
    host, port = parse_address(bind, "--live-bind") if bind else (LOOPBACK, 0)
    return LiveOptions(host, port, control, foxglove)


class View(NamedTuple):
    """A page that is being served. Only who has `address` sees anything."""

    writer: Writer
    address: str
    foxglove_address: str  # empty where none was asked for
    options: LiveOptions

    def notes(self) -> list[str]:
        """Return what a user should know."""
        told = [f"live page: {self.address}"]
        if not is_loopback(self.options.host):
            told.append(f"the live page is reachable from the network at {self.options.host}, without encryption")
        if self.foxglove_address:
            told.append(f"Foxglove: open a connection to {self.foxglove_address}")
        return told


@contextmanager
def live_view(description: Description, options: LiveOptions) -> Iterator[View]:
    """Serve a page while the body runs, in a process of its own; UserError where that can't be."""
    descriptor, memory = create()
    token = new_token()
    process = subprocess.Popen(  # noqa: S603 - this interpreter and this package, no shell
        [sys.executable, "-m", "hil_forceps.live.process", str(descriptor)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        pass_fds=(descriptor,),
        text=True,
        start_new_session=True,  # Ctrl-C ends the run, and that the page
    )
    os.close(descriptor)
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        settings = {**options._asdict(), "token": token}
        with suppress(BrokenPipeError):  # then its answer says why
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
