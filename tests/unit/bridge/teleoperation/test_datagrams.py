"""The datagrams: their bytes, and that nothing else passes for one."""

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil_forceps.bridge.teleoperation.datagrams import (
    ESTIMATE_BYTES,
    REFERENCE_BYTES,
    EstimateDatagram,
    ReferenceDatagram,
    has_tag,
    pack_estimate,
    pack_reference,
    parse_estimate,
    parse_reference,
)

REFERENCE = ReferenceDatagram(0x0123456789ABCDEF, 1, 0xFFFFFFFF, -5, 1.5)
ESTIMATE = EstimateDatagram(7, 1, 9, -5, 3, 123456789, 0.5, -1e-3, 1.25, 2, 2, 1, 1)
TOKEN = b"a token of some length"


def test_the_bytes_of_a_reference_are_those_of_the_page() -> None:
    """docs/teleoperation.md: whoever writes another client goes by these."""
    data = pack_reference(REFERENCE)
    assert len(data) == REFERENCE_BYTES == 56
    assert data.hex() == (
        "4846545201010100efcdab8967452301fbffffffffffffff000000000000f83fffffffff00000000"
        + "00" * 16
    )  # fmt: skip
    assert parse_reference(data) == REFERENCE


def test_the_bytes_of_an_answer_are_those_of_the_page() -> None:
    data = pack_estimate(ESTIMATE)
    assert len(data) == ESTIMATE_BYTES == 80
    assert struct.unpack("<4sBBBBQqqdddIBBBB16s", data) == (
        b"HFTR", 1, 2, 1, 3, 7, -5, 123456789, 0.5, -1e-3, 1.25, 9, 2, 2, 1, 1, bytes(16),
    )  # fmt: skip
    assert parse_estimate(data) == ESTIMATE


def test_a_tag_is_that_of_the_token_and_of_every_byte() -> None:
    data = pack_reference(REFERENCE, TOKEN)
    assert has_tag(data, TOKEN)
    assert not has_tag(data, b"another token")
    assert not has_tag(data, b"")
    assert not has_tag(pack_reference(REFERENCE), TOKEN)
    for place in range(len(data)):
        damaged = bytearray(data)
        damaged[place] ^= 1
        assert not has_tag(bytes(damaged), TOKEN)
    assert parse_estimate(pack_estimate(ESTIMATE, TOKEN), TOKEN) == ESTIMATE
    assert parse_estimate(pack_estimate(ESTIMATE, TOKEN), b"another") is None


def test_the_tag_is_hmac_sha256() -> None:
    """A known answer, RFC 4231's second case."""
    from hil_forceps.bridge.teleoperation.datagrams import tag  # noqa: PLC0415 - beside what it is for

    assert tag(b"what do ya want for nothing?", b"Jefe").hex() == "5bdcc146bf60754e6a042426089575c7"


@pytest.mark.parametrize(
    "data",
    [
        b"",
        pack_reference(REFERENCE)[:-1],
        pack_reference(REFERENCE) + b"\0",
        b"XXXX" + pack_reference(REFERENCE)[4:],
        pack_reference(REFERENCE)[:4] + b"\x02" + pack_reference(REFERENCE)[5:],
        pack_reference(REFERENCE)[:5] + b"\x02" + pack_reference(REFERENCE)[6:],
        pack_reference(REFERENCE)[:7] + b"\x01" + pack_reference(REFERENCE)[8:],
        pack_estimate(ESTIMATE),
    ],
)
def test_anything_else_is_no_reference(data: bytes) -> None:
    assert parse_reference(data) is None


@given(st.binary(max_size=120) | st.binary(min_size=REFERENCE_BYTES, max_size=REFERENCE_BYTES))
def test_bytes_never_raise(data: bytes) -> None:
    found = parse_reference(data)
    assert found is None or pack_reference(found)[:-16] == data[:-16] or math.isnan(found.theta_j_ref_rad)
    parse_estimate(data)
    has_tag(data, TOKEN)
