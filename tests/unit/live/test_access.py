"""Who gets in: the page itself, at an address that is ours, with the token; nobody else."""

import pytest

from hil_forceps.live.access import (
    is_loopback,
    is_our_host,
    is_our_page,
    is_token,
    names_of,
    new_token,
    parse_address,
)
from hil_forceps.rig.errors import UserError

NAMES = names_of("127.0.0.1", 8642)


@pytest.mark.parametrize("host", ["127.0.0.1:8642", "localhost:8642", "LOCALHOST:8642"])
def test_our_own_names(host: str) -> None:
    assert is_our_host(host, NAMES)
    assert is_our_page(f"http://{host}", host)


@pytest.mark.parametrize(
    "host", [None, "", "127.0.0.1", "127.0.0.1:80", "evil.example:8642", "localhost.evil.example:8642", "[::1]:8642"]
)
def test_a_name_that_is_not_ours_gets_nothing(host: str | None) -> None:
    assert not is_our_host(host, NAMES)


@pytest.mark.parametrize(
    "origin",
    [None, "", "null", "http://evil.example", "https://127.0.0.1:8642", "http://127.0.0.1:8643", "file://",
     "http://localhost:8642", "http://127.0.0.1:8642.evil.example"],
)  # fmt: skip
def test_a_socket_of_another_page_is_refused(origin: str | None) -> None:
    assert not is_our_page(origin, "127.0.0.1:8642")


def test_names_of_other_addresses() -> None:
    assert names_of("::1", 5) == {"[::1]:5", "localhost:5"}
    assert names_of("192.168.1.7", 5) == {"192.168.1.7:5"}


def test_tokens() -> None:
    token = new_token()
    assert len(token) >= 43
    assert token != new_token()
    assert is_token(token, token)
    for wrong in (None, b"x", "", token[:-1], token + "x", token.swapcase(), "é" * 43):
        assert not is_token(wrong, token)


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("8642", ("127.0.0.1", 8642)),
        ("127.0.0.1:0", ("127.0.0.1", 0)),
        ("192.168.1.7:8642", ("192.168.1.7", 8642)),
        ("[::1]:8642", ("::1", 8642)),
    ],
)
def test_addresses(text: str, address: tuple[str, int]) -> None:
    assert parse_address(text, "--live-bind") == address


@pytest.mark.parametrize(
    "text", ["", "x", "localhost:1", "1.2.3.4", "127.0.0.1:70000", "127.0.0.1:-1", "1.2.3:4:5", "::"]
)
def test_what_is_no_address_is_told(text: str) -> None:
    with pytest.raises(UserError, match=r"--live-bind .*: must be PORT or ADDRESS:PORT"):
        parse_address(text, "--live-bind")


@pytest.mark.parametrize("host", ["0." * 3 + "0", "::"])
def test_all_interfaces_at_once_are_refused(host: str) -> None:
    with pytest.raises(UserError, match="one numeric address of this machine"):
        parse_address(f"[{host}]:8642", "--live-bind")


def test_loopback() -> None:
    assert is_loopback("127.0.0.1")
    assert is_loopback("127.9.8.7")
    assert is_loopback("::1")
    assert not is_loopback("192.168.1.7")
