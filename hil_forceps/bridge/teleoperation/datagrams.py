"""The datagrams of a teleoperation (docs/teleoperation.md): one way a reference, the other way estimates. Pure.

Both are packed little-endian and of fixed length. Both end with a tag: the first 16 bytes of HMAC-SHA256 over what
stands before it, with the token as the key; without a token it is zero.
"""

import hmac
import math
import struct
from enum import IntEnum
from typing import Final, NamedTuple

MAGIC: Final = b"HFTR"
VERSION: Final = 1
KIND_REFERENCE: Final = 1
KIND_ESTIMATE: Final = 2
TAG_BYTES: Final = 16
NO_TAG: Final = bytes(TAG_BYTES)
_REFERENCE: Final = struct.Struct("<4sBBBBQqdII")
_ESTIMATE: Final = struct.Struct("<4sBBBBQqqdddIBBBB")
REFERENCE_BYTES: Final = _REFERENCE.size + TAG_BYTES
ESTIMATE_BYTES: Final = _ESTIMATE.size + TAG_BYTES


class Verdict(IntEnum):
    """What became of a reference; the numbers stand in the answers."""

    ACCEPTED = 0
    WRONG_SESSION = 1  # not of this run; the answer has its number
    OTHER_SENDER = 2  # another one has the axis
    DUPLICATE = 3
    REORDERED = 4  # a later one came before it
    STALE = 5  # too long under way
    NOT_FINITE = 6
    NO_SUCH_AXIS = 7


class ReferenceDatagram(NamedTuple):
    """What a sender wants."""

    session: int  # of the run, as an answer tells it; 0 before that
    axis: int
    sequence: int  # one more with each, modulo 2**32
    stamp_ns: int  # the sender's own clock
    theta_j_ref_rad: float


class EstimateDatagram(NamedTuple):
    """What a sender is told. Estimates are NaN before the first sample."""

    session: int
    axis: int
    sequence: int  # of the reference that it answers
    stamp_ns: int  # the same
    verdict: int  # a `Verdict`
    sample_ns: int  # host's clock: when the sample arrived that the estimates are made of
    theta_j_rad: float  # jaw angle by motor angle and estimated elongation
    tau_w_N_m: float
    theta_j_ref_rad: float  # the reference that is in force
    stage: int  # 0 connecting, 1 enabling, 2 running, 3 stopping, 4 stopped, 5 ended
    drive_state: int  # 0 disabled, 1 armed, 2 operational, 3 fault; 255 not heard yet
    gate_state: int  # 0 closed, 1 open, 2 frozen, 3 failing, 4 latched
    input_state: int  # 0 waiting, 1 following


def tag(data: bytes, token: bytes) -> bytes:
    """Return the tag of a datagram's bytes; zero without a token."""
    return hmac.digest(token, data, "sha256")[:TAG_BYTES] if token else NO_TAG


def pack_reference(reference: ReferenceDatagram, token: bytes = b"") -> bytes:
    """Return a reference as a datagram; struct.error for what doesn't fit."""
    session, axis, sequence, stamp_ns, theta_rad = reference
    data = _REFERENCE.pack(MAGIC, VERSION, KIND_REFERENCE, axis, 0, session, stamp_ns, theta_rad, sequence, 0)
    return data + tag(data, token)


def parse_reference(data: bytes) -> ReferenceDatagram | None:
    """Return what a datagram says, None where it is none of these. The tag is not looked at."""
    if len(data) != REFERENCE_BYTES:
        return None
    magic, version, kind, axis, spare, session, stamp_ns, theta_rad, sequence, rest = _REFERENCE.unpack_from(data)
    if (magic, version, kind, spare, rest) != (MAGIC, VERSION, KIND_REFERENCE, 0, 0):
        return None
    return ReferenceDatagram(session, axis, sequence, stamp_ns, theta_rad)


def pack_estimate(estimate: EstimateDatagram, token: bytes = b"") -> bytes:
    """Return an answer as a datagram."""
    data = _ESTIMATE.pack(
        MAGIC, VERSION, KIND_ESTIMATE, estimate.axis, estimate.verdict, estimate.session, estimate.stamp_ns,
        estimate.sample_ns, estimate.theta_j_rad, estimate.tau_w_N_m, estimate.theta_j_ref_rad, estimate.sequence,
        estimate.stage, estimate.drive_state, estimate.gate_state, estimate.input_state,
    )  # fmt: skip
    return data + tag(data, token)


def parse_estimate(data: bytes, token: bytes = b"") -> EstimateDatagram | None:
    """Return what an answer says, None where it is none, or has the wrong tag."""
    if len(data) != ESTIMATE_BYTES or not has_tag(data, token):
        return None
    magic, version, kind, axis, verdict, session, stamp_ns, sample_ns, *rest = _ESTIMATE.unpack_from(data)
    if (magic, version, kind) != (MAGIC, VERSION, KIND_ESTIMATE):
        return None
    theta_rad, tau_w_N_m, reference_rad, sequence, *states = rest
    return EstimateDatagram(
        session, axis, sequence, stamp_ns, verdict, sample_ns, theta_rad, tau_w_N_m, reference_rad, *states
    )


def has_tag(data: bytes, token: bytes) -> bool:
    """Tell whether a datagram ends with the right tag, in a time that does not depend on where it differs."""
    return hmac.compare_digest(data[-TAG_BYTES:], tag(data[:-TAG_BYTES], token))


def is_usable(reference: ReferenceDatagram) -> bool:
    """Tell whether the angle is a number that a jaw can have."""
    return math.isfinite(reference.theta_j_ref_rad)
