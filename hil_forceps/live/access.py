"""Who may see a live page: rules on what a browser sends with a request. Pure.

Other users of the machine reach a port on loopback, and so does any web page that a browser on it shows. Against both
there is a token, which the page's address carries behind `#`, where no server and no log sees it. `Host` has to be an
address under which the page was opened, so that a name that somebody points at 127.0.0.1 (DNS rebinding) gets nothing;
`Origin` has to be the page itself, so that no other page opens the socket.
"""

import hmac
import ipaddress
import secrets
from typing import Final

from hil_forceps.rig.errors import UserError

POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self' {socket}; img-src 'self' data: blob:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'; require-trusted-types-for 'script'; "
    "trusted-types 'none'"
)
LOOPBACK: Final = "127.0.0.1"


def new_token() -> str:
    """Return a token that nobody guesses: 256 bits."""
    return secrets.token_urlsafe(32)


def parse_address(text: str, option: str) -> tuple[str, int]:
    """Return host and port of `PORT`, `ADDRESS:PORT` or `[ADDRESS]:PORT`; without address loopback. UserError."""
    host, _, port = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]") or LOOPBACK
    try:
        number = int(port)
        if ipaddress.ip_address(host).is_unspecified:  # a browser's `Host` could be anything then
            number = -1
    except ValueError:
        number = -1
    if not 0 <= number <= 0xFFFF:
        raise UserError(
            f"{option} {text}: must be PORT or ADDRESS:PORT with one numeric address of this machine, as 127.0.0.1:8642"
        )
    return host, number


def is_loopback(host: str) -> bool:
    """Tell whether an address is this machine's own."""
    return ipaddress.ip_address(host).is_loopback


def names_of(host: str, port: int) -> frozenset[str]:
    """Return what a browser may call the server that is bound to `host`: the values of `Host`."""
    address = ipaddress.ip_address(host)
    named = f"[{host}]" if address.version == 6 else host
    hosts = {named, "localhost"} if address.is_loopback else {named}
    return frozenset(f"{name}:{port}" for name in hosts)


def is_our_host(host: str | None, names: frozenset[str]) -> bool:
    """Tell whether a request was meant for us."""
    return host is not None and host.lower() in names


def is_our_page(origin: str | None, host: str | None) -> bool:
    """Tell whether a socket was opened by the page of the same address."""
    return origin is not None and host is not None and origin.lower() == f"http://{host.lower()}"


def is_token(given: object, token: str) -> bool:
    """Tell whether a token is the right one, in a time that does not depend on where it differs."""
    return isinstance(given, str) and hmac.compare_digest(given.encode(), token.encode())
