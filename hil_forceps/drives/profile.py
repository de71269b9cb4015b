"""What the house knows of a motor driver's protocol: one `Profile` each, from the rig to findings, frames and words."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any, Final, Literal, NamedTuple, Protocol

from firmware_protocol.frames import Frame
from hil_forceps.drives.framing import NATIVE, Framing
from hil_forceps.drives.inquiry import Inquiry
from hil_forceps.drives.line_use import most_bits
from hil_forceps.drives.port import DriveMachine
from hil_forceps.drives.promises import Promises
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError
from hil_forceps.rig.sections import MotorDriver

LOAD_N_M: Final = 2.0e-3  # at the jaw: the paper's, for the wire's stretch and the torque and current that it takes
MAX_QUANTUM_SHARE: Final = 0.05  # of what `LOAD_N_M` makes of it, that a step of the drive's may be
_FLOAT_BITS: Final = 24  # of a 32-bit float's significand


class Finding(NamedTuple):
    """What was found at a key of the rig: a `problem` where a run can't work or isn't safe, else a `note`."""

    level: Literal["problem", "note"]
    key: str
    text: str


class Found(NamedTuple):
    """A drive that was heard."""

    profile: str  # as a rig's `motor_driver.profile` names it
    node: int
    says: str  # its state, and what it sends


class Decoded(NamedTuple):
    """A frame in words: what it is, and its values with their units in the names."""

    name: str
    values: dict[str, Any]


class Quantum(NamedTuple):
    """The steps in which a drive tells its angle, or takes its reference."""

    key: str  # of the rig, that sets it
    pulley_rev: float


class Listener(Protocol):
    """Hears which drives of one profile are there; sends nothing."""

    def receive(self, frame: Frame) -> bool:
        """Take one frame; True where it can be nothing but this profile's."""

    def found(self) -> list[Found]:
        """Return the drives heard so far, by node."""


def torque_constant_N_m_per_A(rig: Rig) -> float:
    """Return the torque on the motor pulley per ampere; UserError where it isn't known."""
    value = rig.motor.torque_constant_N_m_per_A.value
    if value is None:
        raise UserError("motor.torque_constant_N_m_per_A: has no value, but one is needed here; give a value")
    return value


def usual_promises(_rig: Rig, _settings: MotorDriver) -> Promises:
    """Return what most drives promise."""
    return Promises()


@dataclass(frozen=True, slots=True)
class Profile:
    """One protocol. Functions take a rig whose `motor_driver.profile` is this one's, with that section."""

    name: str
    link: Literal["can", "serial"]
    machine: Callable[[Rig, MotorDriver], DriveMachine]  # UserError where the rig doesn't go with the protocol
    sample_period_s: Callable[[Rig, MotorDriver], float]  # between the drive's samples
    findings: Callable[[Rig, MotorDriver], Iterator[Finding]]
    bus_load: Callable[[Rig, MotorDriver], float]  # share of the line's time that one axis takes, at worst
    quantum: Callable[[Rig, MotorDriver], Quantum | None]  # coarser than the encoder's count, where it is
    listener: Callable[[], Listener]
    decode: Callable[[Frame], Decoded | None]
    # Arbitration ids of the drive, each with whether it has 29 bits; none on a line of its own.
    ids: Callable[[MotorDriver], frozenset[tuple[int, bool]]] = lambda _: frozenset()
    # Of several drives on one bus, where they have anything in common; else each is made alone.
    machines: Callable[[Sequence[tuple[Rig, MotorDriver]]], list[DriveMachine]] | None = None
    bus_ids: frozenset[tuple[int, bool]] = frozenset()  # those of hosts of this profile, which its drives may share
    shared_load: Callable[[Rig], float] = lambda _: 0.0  # of `bus_load`, what is there once for all drives of a bus
    has_extended_ids: bool = False  # frames with ids of 29 bits may be its own
    speaks_fd: bool = False  # in frames of CAN FD alone
    tells_current_limit: bool = False  # the machine tells the drive `motor_driver.current_limit_A`
    framing: Framing = NATIVE  # of its packets on a serial line
    ask: tuple[Frame, ...] = ()  # who is there, where drives say nothing by themselves; moves and changes nothing
    promises: Callable[[Rig, MotorDriver], Promises] = usual_promises  # what conformance holds the drive to
    inquiry: Callable[[MotorDriver], Inquiry] | None = None  # None: it answers to commands alone


def check_node(settings: MotorDriver, lowest: int, highest: int) -> None:
    """UserError where the node id isn't one of the protocol."""
    if not lowest <= settings.node_id <= highest:
        raise UserError(
            f"motor_driver.node_id: is {settings.node_id}, but the nodes of the profile {settings.profile} are "
            f"{lowest} to {highest}; correct it"
        )


def host_ids(candidates: Iterable[int], nodes: Iterable[int], count: int) -> list[int]:
    """Return ids that the host takes for itself, one for each drive; UserError where there are more drives than ids."""
    taken = set(nodes)
    free = [each for each in candidates if each not in taken][:count]
    if len(free) < count:
        raise UserError(
            f"motor_driver: {count} drives on one bus; the profile supports at most {len(free)}; use several buses"
        )
    return free


def too_old_by_polling(rig: Rig) -> Iterator[Finding]:
    """Find a limit on a sample's age that no drive can keep that is asked for its sample a tick ahead."""
    age_s, period_s = rig.limits.max_sample_age_s, rig.bench.host_period_s
    if age_s <= 1.5 * period_s:
        yield Finding(
            "problem",
            "limits.max_sample_age_s",
            f"is {age_s:g} s, but a sample is requested one tick before it is used; set at least {2.0 * period_s:g} s",
        )


def classic_load(rig: Rig, frames_per_s: float) -> float:
    """Return the share of a CAN bus that this many classic frames of eight bytes take, at worst."""
    return frames_load(rig, [(8, frames_per_s)])


def frames_load(
    rig: Rig, rates: Iterable[tuple[int, float]], *, is_fd: bool = False, is_extended: bool = False
) -> float:
    """Return the share of a CAN bus that frames take at worst; `rates`: their bytes, and how many come in a second."""
    bench, load = rig.bench, 0.0
    for length, per_s in rates:
        nominal, data = most_bits(length, is_fd, is_extended)
        load += per_s * (nominal / bench.bitrate_bit_per_s + data / bench.data_bitrate_bit_per_s)
    return load


def float_quantum(rig: Rig, settings: MotorDriver) -> Quantum:
    """Return the step of an angle in turns that goes as a 32-bit float, at the far end of the limits."""
    ratio = abs(settings.encoder_rev_per_pulley_rev)
    reach_rad = max(abs(rig.limits.position_min_rad), abs(rig.limits.position_max_rad))
    largest_rev = abs(settings.encoder_zero_rev) + reach_rad / (2.0 * math.pi) * ratio
    step_rev = 2.0 ** (math.ceil(math.log2(max(largest_rev, 1e-6))) - _FLOAT_BITS)
    return Quantum("motor_driver.encoder_zero_rev", step_rev / ratio)


def member_name(kind: type[Enum], value: int) -> str | int:
    """Return the name of a value, or the value where it has none."""
    return next((str(member.name) for member in kind if member.value == value), value)
