"""Access rules of the live page, from the headers of a request; pure functions.

Other users of the computer can reach a port on loopback, and so can any web page in a browser on it. Against both there
is a token in the page's address after `#`, which is not sent to a server or log. `Host` must be an address of the page,
so that another name for 127.0.0.1 (DNS rebinding) is refused; `Origin` must be the page itself, so that no other page
opens the socket.
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
    """Return a random token of 256 bits."""
    return secrets.token_urlsafe(32)


def parse_address(text: str, option: str) -> tuple[str, int]:
    """Return host and port of `PORT`, `ADDRESS:PORT` or `[ADDRESS]:PORT`; default address: loopback. UserError."""
    host, _, port = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]") or LOOPBACK
    try:
        number = int(port)
        if ipaddress.ip_address(host).is_unspecified:  # then the allowed values of `Host` are unknown
            number = -1
    except ValueError:
        number = -1
    if not 0 <= number <= 0xFFFF:
        raise UserError(
            f"{option} {text}: must be PORT or ADDRESS:PORT with one numeric address of this machine, as 127.0.0.1:8642"
        )
    return host, number


def is_loopback(host: str) -> bool:
    """Return whether an address is a loopback address."""
    return ipaddress.ip_address(host).is_loopback


def names_of(host: str, port: int) -> frozenset[str]:
    """Return the allowed values of the header `Host` for a server at `host`."""
    address = ipaddress.ip_address(host)
    named = f"[{host}]" if address.version == 6 else host
    hosts = {named, "localhost"} if address.is_loopback else {named}
    return frozenset(f"{name}:{port}" for name in hosts)


def is_our_host(host: str | None, names: frozenset[str]) -> bool:
    """Return whether the header `Host` is allowed."""
    return host is not None and host.lower() in names


def is_our_page(origin: str | None, host: str | None) -> bool:
    """Return whether a socket was opened by the page at the same address."""
    return origin is not None and host is not None and origin.lower() == f"http://{host.lower()}"


def is_token(given: object, token: str) -> bool:
    """Compare a token in a time that does not depend on where it differs."""
    return isinstance(given, str) and hmac.compare_digest(given.encode(), token.encode())
