"""Mini cheetah drives in the house: from the rig to the machine, what doesn't go together, and frames in words."""

import math
from collections.abc import Iterator
from typing import Any, Final

from firmware_protocol.frames import Frame
from hil_forceps.drives.mit import messages as wire
from hil_forceps.drives.mit.machine import Mit, MitConfig
from hil_forceps.drives.port import DriveMachine
from hil_forceps.drives.profile import (
    LOAD_N_M,
    MAX_QUANTUM_SHARE,
    Decoded,
    Finding,
    Found,
    Profile,
    Quantum,
    check_node,
    classic_load,
    torque_constant_N_m_per_A,
)
from hil_forceps.drives.promises import Promises
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError
from hil_forceps.rig.plant import PlantParameters
from hil_forceps.rig.sections import MotorDriver

_RANGES: Final = (
    "position_range_rad",
    "speed_range_rad_per_s",
    "kp_range_N_m_per_rad",
    "kd_range_N_m_s_per_rad",
    "torque_range_N_m",
)
GAIN_MARGIN: Final = 2.0  # 6 dB, the textbooks' least
_FRAMES_PER_TICK: Final = 2.0  # a command and its answer
_BYTES: Final = 8


def _needed(settings: MotorDriver, key: str) -> float:
    value: float | None = getattr(settings, key)
    if value is None:
        raise UserError(
            f"motor_driver.{key}: is missing; a drive of the profile mit does not report it, and there is no "
            "default; give a value"
        )
    return value


def _config(rig: Rig, settings: MotorDriver) -> MitConfig:
    """Return what the machine needs; UserError where the rig doesn't say it, or the wire can't carry it."""
    variant = settings.mit_variant
    if variant is None:
        raise UserError("motor_driver.mit_variant: is missing; set bgkatz, cubemars or damiao")
    check_node(settings, 1, wire.MAX_NODE)
    ranges = wire.Ranges(*(_needed(settings, key) for key in _RANGES))
    gains = {key: _needed(settings, key) for key in ("kp_N_m_per_rad", "kd_N_m_s_per_rad")}
    for (key, gain), high in zip(gains.items(), (ranges.kp_N_m_per_rad, ranges.kd_N_m_s_per_rad), strict=True):
        if gain > high:
            raise UserError(
                f"motor_driver.{key}: is {gain:g}, but the largest value of its field is {high:g}; lower it"
            )
    reach_rad = _reach_rad(rig, settings)
    if reach_rad >= ranges.position_rad:
        raise UserError(
            f"motor_driver.position_range_rad: is {ranges.position_rad:g} rad, but limits: allow {reach_rad:.4g} "
            "rad of the drive's shaft, where angles saturate or wrap; widen it, or narrow limits:"
        )
    return MitConfig(
        node=settings.node_id,
        reply_id=_reply_id(settings),
        variant=variant,
        ranges=ranges,
        current_range_A=_current_range_A(torque_constant_N_m_per_A(rig), settings, ranges),
        **gains,
        rev_per_pulley_rev=settings.encoder_rev_per_pulley_rev,
        zero_rev=settings.encoder_zero_rev,
        period_ns=round(rig.bench.host_period_s * 1e9),
        max_sample_age_ns=round(rig.limits.max_sample_age_s * 1e9),
    )


def _reply_id(settings: MotorDriver) -> int:
    """Return the id of the drive's answers; absent: the makers' defaults."""
    if settings.reply_id is not None:
        return settings.reply_id
    return settings.node_id if settings.mit_variant == "cubemars" else 0


def _reach_rad(rig: Rig, settings: MotorDriver) -> float:
    """Return how far from its zero the drive's shaft gets within the limits."""
    zero_rad, ratio = 2.0 * math.pi * settings.encoder_zero_rev, settings.encoder_rev_per_pulley_rev
    ends = (rig.limits.position_min_rad, rig.limits.position_max_rad)
    return max(abs(zero_rad + end * ratio) for end in ends)


def _current_range_A(constant_N_m_per_A: float, settings: MotorDriver, ranges: wire.Ranges) -> float:
    ratio = settings.encoder_rev_per_pulley_rev
    if settings.feedback_current_range_A is not None:
        return math.copysign(settings.feedback_current_range_A, ratio)
    return ranges.torque_N_m * ratio / constant_N_m_per_A


def _findings(rig: Rig, settings: MotorDriver) -> Iterator[Finding]:
    config = _config(rig, settings)
    yield from _gains(config)
    yield from _of_plant(config, rig)
    if config.variant == "cubemars":
        yield Finding(
            "note",
            "motor_driver.watchdog_s",
            "the AK manual (V1.0.8) documents no time-out in MIT mode; test on the bench what the motor does when the "
            "bus is disconnected",
        )
    age_s, period_s = rig.limits.max_sample_age_s, rig.bench.host_period_s
    if age_s < 2.0 * period_s:
        yield Finding(
            "problem",
            "limits.max_sample_age_s",
            f"is {age_s:g} s, but the drive answers only to commands: after a lost answer the next sample comes two "
            f"periods later; set at least {2.0 * period_s:g} s",
        )


def _of_plant(config: MitConfig, rig: Rig) -> Iterator[Finding]:
    """What torque and gains are for this forceps, as far as that is known."""
    try:
        plant = rig.plant()
    except UserError:
        return
    yield from _torque(config, plant)
    yield from _stiffness(config, plant)


def _gains(config: MitConfig) -> Iterator[Finding]:
    """What a gain becomes in steps of its field."""
    for key, gain, high in (
        ("kp_N_m_per_rad", config.kp_N_m_per_rad, config.ranges.kp_N_m_per_rad),
        ("kd_N_m_s_per_rad", config.kd_N_m_s_per_rad, config.ranges.kd_N_m_s_per_rad),
    ):
        code = wire.code_of(gain, 0.0, high, wire.MAX_CODE)
        sent = wire.value_of(code, 0.0, high, wire.MAX_CODE)
        text = f"is {gain:g}, sent as {sent:.3g}: its field has steps of {high / wire.MAX_CODE:.2g}"
        if code == 0:
            yield Finding(
                "problem", f"motor_driver.{key}", f"{text}; lower the range of the drive, or use another drive"
            )
        elif abs(sent - gain) > MAX_QUANTUM_SHARE * gain:
            yield Finding("note", f"motor_driver.{key}", text)


def _torque(config: MitConfig, plant: PlantParameters) -> Iterator[Finding]:
    """The step of the torque, in which zero lies between two codes, against what the load takes."""
    load_N_m = LOAD_N_M * plant.motor_pulley_radius_m / plant.jaw_pulley_radius_m
    step_N_m = abs(config.current_range_A) * plant.torque_constant_N_m_per_A * 2.0 / wire.MAX_CODE
    key, text = "motor_driver.torque_range_N_m", f"the drive's torque has a resolution of {1e3 * step_N_m:.3g} mN m"
    if step_N_m > load_N_m:
        yield Finding(
            "problem",
            key,
            f"{text}, coarser than the {1e3 * load_N_m:.3g} mN m that {LOAD_N_M * 1e3:g} mN m at the jaw need: the "
            "load can't be estimated",
        )
    elif step_N_m > MAX_QUANTUM_SHARE * load_N_m:
        yield Finding(
            "note", key, f"{text}, {100.0 * step_N_m / load_N_m:.0f} % of what {LOAD_N_M * 1e3:g} mN m at the jaw need"
        )
    ratio = abs(config.rev_per_pulley_rev)
    torque_N_m = config.ranges.torque_N_m / wire.MAX_CODE
    damping_N_m = config.kd_N_m_s_per_rad * config.ranges.speed_rad_per_s / wire.MAX_CODE
    offset_N_m = abs(damping_N_m - torque_N_m) * ratio
    if offset_N_m > MAX_QUANTUM_SHARE * load_N_m:
        yield Finding(
            "note",
            key,
            f"no code is exactly zero: {1e3 * offset_N_m:.3g} mN m remain on the pulley while the drive is enabled, "
            f"{100.0 * offset_N_m / load_N_m:.0f} % of what {LOAD_N_M * 1e3:g} mN m at the jaw need",
        )


def _stiffness(config: MitConfig, plant: PlantParameters) -> Iterator[Finding]:
    """The gain around compensation and position loop.

    A reference that steps by d asks for the torque kp d at once. The estimator takes that for load, and equation (10)
    adds the stretch that such a load makes, kp d / (k r_m^2), to the reference.
    """
    loop_N_m_per_rad = config.kp_N_m_per_rad * config.rev_per_pulley_rev**2
    wire_N_m_per_rad = plant.wire_stiffness_N_per_m * plant.motor_pulley_radius_m**2
    gain = loop_N_m_per_rad / wire_N_m_per_rad
    text = (
        f"is {loop_N_m_per_rad:.3g} N m/rad at the pulley, {gain:.2g} times the wire's {wire_N_m_per_rad:.3g}: "
        "the compensation feeds this share of a step back"
    )
    if gain >= 1.0:
        yield Finding("problem", "motor_driver.kp_N_m_per_rad", f"{text} and oscillates; lower it")
    elif gain > 1.0 / GAIN_MARGIN:
        yield Finding("note", "motor_driver.kp_N_m_per_rad", f"{text}; a gain margin of {GAIN_MARGIN:g} is usual")


def _ids(settings: MotorDriver) -> frozenset[tuple[int, bool]]:
    return frozenset({(settings.node_id, False), (_reply_id(settings), False)})


def _quantum(rig: Rig, settings: MotorDriver) -> Quantum:
    del rig
    step_rad = 2.0 * _needed(settings, "position_range_rad") / wire.MAX_POSITION_CODE
    step_rev = step_rad / (2.0 * math.pi) / abs(settings.encoder_rev_per_pulley_rev)
    return Quantum("motor_driver.position_range_rad", step_rev)


class _Listener:
    """Hears nobody: such a drive says nothing that it isn't asked."""

    def receive(self, frame: Frame) -> bool:
        """Take one frame."""
        del frame
        return False

    def found(self) -> list[Found]:
        """Return nobody."""
        return []


def _share(code: int, codes: int) -> float:
    return round(2.0 * code / codes - 1.0, 5)


def decode(frame: Frame) -> Decoded | None:
    """Return a frame with values as shares of their ranges, which only the rig knows.

    Command and answer of eight bytes are told by id and first byte: an answer comes under its own motor's id, or under
    another that is no motor's (0, or 10h and above with the motor's number in the lower half of the first byte).
    """
    arbitration_id, data = frame.arbitration_id, frame.data
    which, reply = wire.special_of(data), wire.parse_reply(data)
    if which is not None:
        return Decoded(which.name, {"node": arbitration_id})
    if reply is None:
        return None
    is_elsewhere = arbitration_id == 0 or (arbitration_id > 0xF and reply.head & 0xF == arbitration_id & 0xF)
    if len(data) < _BYTES or arbitration_id == reply.head or is_elsewhere:
        return Decoded("REPLY", _reply_values(reply))
    codes = wire.parse_command(data)
    assert codes is not None  # eight bytes, and not special
    values = {
        "node": arbitration_id,
        "position_of_range": _share(codes.position, wire.MAX_POSITION_CODE),
        "speed_of_range": _share(codes.speed, wire.MAX_CODE),
        "kp_of_range": round(codes.kp / wire.MAX_CODE, 5),
        "kd_of_range": round(codes.kd / wire.MAX_CODE, 5),
        "torque_of_range": _share(codes.torque, wire.MAX_CODE),
    }
    return Decoded("COMMAND", values)


def _reply_values(reply: wire.Reply) -> dict[str, Any]:
    return {
        "head": f"0x{reply.head:02x}",
        "position_of_range": _share(reply.position, wire.MAX_POSITION_CODE),
        "speed_of_range": _share(reply.speed, wire.MAX_CODE),
        "torque_of_range": _share(reply.torque, wire.MAX_CODE),
        "extra": reply.extra.hex(),
    }


def _machine(rig: Rig, settings: MotorDriver) -> DriveMachine:
    return Mit(_config(rig, settings))


def _promises(rig: Rig, settings: MotorDriver) -> Promises:
    repeats_s = rig.limits.max_sample_age_s  # for so long the machine repeats a reference whose answer is missing
    return Promises(
        starved="released",
        reaction_s=None if settings.mit_variant == "cubemars" else repeats_s,
        tells_state=settings.mit_variant == "damiao",
        tells_watchdog=False,
        harmless_counters=frozenset({"repeats", "releases"}),
    )


PROFILE: Final = Profile(
    name="mit",
    link="can",
    machine=_machine,
    sample_period_s=lambda rig, _: rig.bench.host_period_s,  # it answers to commands alone
    findings=_findings,
    bus_load=lambda rig, _: classic_load(rig, _FRAMES_PER_TICK / rig.bench.host_period_s),
    quantum=_quantum,
    listener=_Listener,
    decode=decode,
    promises=_promises,
    ids=_ids,
)
