"""The sections of a rig file, as frozen models whose attributes are the file's keys. All SI.

Every key has its unit and range of sense in its `Quantity` and its meaning in its description; `docs/rig-file.md` is
generated from them.
"""

import math
import re
from typing import Annotated, Literal, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    Field,
    field_serializer,
)

from hil_forceps.rig.effects import check_effects
from hil_forceps.rig.quantities import STRICT, Number, Parameter, Quantity, Whole
from hil_forceps.rig.validation.problems import show_value, text_error

AlgorithmId = Literal["previous", "improved_as_published", "improved", "kalman"]
ALGORITHM_IDS: tuple[AlgorithmId, ...] = get_args(AlgorithmId)
IDEAL = "ideal"
MAX_NODE_ID = 30
MAX_ENCODER_COUNTS = 1 << 24  # what the wire resolves

_Radius = Annotated[Parameter, Quantity("m", 0.0, 0.2, open_low=True)]
_Inertia = Annotated[Parameter, Quantity("kg_m2", 0.0, 1e-2, open_low=True)]
_Friction = Annotated[Parameter, Quantity("N_m", 0.0, 10.0)]
# The wire's angle wraps at 128 turns, 804 rad.
_Position = Annotated[Number, Quantity("rad", -800.0, 800.0)]
_LIST = Field(strict=False)
_Delay = Annotated[Number, Quantity("s", 0.0, 1.0)]


class Section(BaseModel):
    """A section of the file: strict, frozen, no keys but the known ones."""

    model_config = STRICT


class Forceps(Section):
    """Motor pulley, wire and jaw: the symbols of the paper's equations (1) to (3)."""

    motor_pulley_radius_m: _Radius = Field(description="radius of the motor pulley, r_m")
    jaw_pulley_radius_m: _Radius = Field(description="radius of the jaw pulley, r_j")
    motor_inertia_kg_m2: _Inertia = Field(description="inertia of motor and its pulley, I_m")
    jaw_inertia_kg_m2: _Inertia = Field(description="inertia of the jaw and its pulley, I_j")
    motor_viscous_N_m_s_per_rad: Annotated[Parameter, Quantity("N_m_s_per_rad", 0.0, 1.0)] = Field(
        description="viscous friction of the motor, D_m"
    )
    motor_coulomb_N_m: _Friction = Field(description="Coulomb friction of the motor, τ_Fm")
    jaw_coulomb_N_m: _Friction = Field(description="Coulomb friction of the jaw, τ_Fj")
    wire_stiffness_N_per_m: Annotated[Parameter, Quantity("N_per_m", 1.0, 1e9)] = Field(
        description="stiffness of the wire, k"
    )


class Motor(Section):
    """The motor as seen from its current."""

    torque_constant_N_m_per_A: Annotated[Parameter, Quantity("N_m_per_A", 0.0, 10.0, open_low=True)] = Field(
        description="torque per ampere, K_t"
    )


def _read_counts(given: object) -> object:
    if given == IDEAL:
        return None
    if isinstance(given, str):
        raise text_error(f"is {show_value(given)}, must be the counts of a revolution or {IDEAL}; correct it")
    return given


class Encoder(Section):
    """The encoder on the motor pulley."""

    counts_per_rev: Annotated[
        Annotated[Whole, Quantity("", 4, MAX_ENCODER_COUNTS)] | None, BeforeValidator(_read_counts)
    ] = Field(
        description=f"counts of a revolution after quadrature; `{IDEAL}`: no quantisation but the wire's 2⁻²⁴ turn"
    )

    @property
    def quantum_rad(self) -> float:
        """Angle of a count; 0 for an ideal encoder."""
        return 0.0 if self.counts_per_rev is None else 2.0 * math.pi / self.counts_per_rev

    @field_serializer("counts_per_rev")
    def _write_counts(self, counts: int | None) -> int | str:
        return IDEAL if counts is None else counts


class DriveLaw(Section):
    """The position loop that the drive closes (law: see below). Absent: the loop is not known."""

    sample_time_s: Annotated[Number, Quantity("s", 1e-6, 0.1)] = Field(description="period of the drive's loop")
    kp_A_per_rad: Annotated[Number, Quantity("A_per_rad", 0.0, 1e6)] = Field(description="proportional gain")
    ki_A_per_rad_s: Annotated[Number, Quantity("A_per_rad_s", 0.0, 1e8)] = Field(description="integral gain")
    kd_A_s_per_rad: Annotated[Number, Quantity("A_s_per_rad", 0.0, 1e4)] = Field(
        description="gain on the measured velocity, first-order filtered"
    )
    derivative_cutoff_Hz: Annotated[Number, Quantity("Hz", 0.0, 1e6, open_low=True)] = Field(
        description="corner of that filter"
    )
    current_limit_A: Annotated[Number, Quantity("A", 0.0, 200.0, open_low=True)] = Field(
        description="limit of the commanded current and of the integral's part of it"
    )
    cascade_time_s: Annotated[Number, Quantity("s", 0.0, 100.0)] = Field(
        default=0.0,
        description="1/K, where K is the gain of a position loop around a velocity loop; 0: no such cascade, a PID",
    )


class Noise(Section):
    """Standard deviations of the sensors where known; the simulated world takes 0 where a key is absent."""

    current_A: Annotated[Number, Quantity("A", 0.0, 10.0)] = Field(default=0.0, description="of the measured current")
    theta_j_rad: Annotated[Number, Quantity("rad", 0.0, 0.5)] = Field(
        default=0.0, description="of the bench's jaw sensor"
    )
    tau_w_N_m: Annotated[Number, Quantity("N_m", 0.0, 1.0)] = Field(default=0.0, description="of the bench's load cell")


def _without_repeats(given: tuple[object, ...]) -> tuple[object, ...]:
    if len(set(given)) != len(given):
        raise text_error("names an entry twice; keep one of them")
    return given


def _some(given: tuple[object, ...]) -> tuple[object, ...]:
    if not given:
        raise text_error("is empty; name one at least")
    return given


class BenchSettings(Section):
    """How the bench runs: the host's loop, the bus between host and drive, and what is run on it."""

    host_period_s: Annotated[Number, Quantity("s", 1e-4, 0.1)] = Field(
        default=1e-3, description="period of the host's loop"
    )
    host_phase_s: Annotated[Number, Quantity("s", 0.0, 0.1)] = Field(
        default=6e-4, description="host's tick after the drive's nominal sample"
    )
    transport: Literal["classic", "fd"] = Field(default="classic", description="classic CAN or CAN FD")
    bitrate_bit_per_s: Annotated[Whole, Quantity("bit_per_s", 10_000, 1_000_000)] = Field(
        default=1_000_000, description="bit rate; with `fd` that of the arbitration phase"
    )
    data_bitrate_bit_per_s: Annotated[Whole, Quantity("bit_per_s", 10_000, 8_000_000)] = Field(
        default=5_000_000, description="bit rate of the data phase, `fd` only"
    )
    latency_s: _Delay = Field(default=0.0, description="extra one-way delay between host and wire")
    latency_jitter_s: _Delay = Field(default=0.0, description="random part on top of it, per frame, up to this much")
    drive_clock_ppm: Annotated[Number, Quantity("ppm", -20_000.0, 20_000.0)] = Field(
        default=0.0, description="how much faster the drive's clock runs than the host's"
    )
    feedback_divider: Annotated[Whole, Quantity("", 1, 1000)] = Field(
        default=1, description="the drive sends feedback at every n-th sample"
    )
    node_id: Annotated[Whole, Quantity("", 1, MAX_NODE_ID)] = Field(default=1, description="node id of the drive")
    algorithms: Annotated[tuple[AlgorithmId, ...], _LIST, AfterValidator(_some), AfterValidator(_without_repeats)] = (
        Field(default=ALGORITHM_IDS, description="estimators to run")
    )
    simulations: Annotated[
        tuple[Literal[1, 2], ...], _LIST, AfterValidator(_some), AfterValidator(_without_repeats)
    ] = Field(default=(1, 2), description="the paper's simulations to run")
    direct_sample_times_s: Annotated[
        tuple[Annotated[Number, Quantity("s", 1e-6, 0.1)], ...], _LIST, AfterValidator(_without_repeats)
    ] = Field(default=(1e-4,), description="sample times at which estimators are also fed without the bus")
    plant_step_s: Annotated[Number, Quantity("s", 1e-7, 1e-2)] = Field(
        default=5e-5, description="step of the simulated plant"
    )


class Limits(Section):
    """What the gate lets pass to the drive: the last stage before any reference leaves."""

    position_min_rad: _Position = Field(default=-3.0, description="lowest motor angle")
    position_max_rad: _Position = Field(default=3.0, description="highest motor angle")
    speed_max_rad_per_s: Annotated[Number, Quantity("rad_per_s", 0.0, 1e6, open_low=True)] = Field(
        default=200.0, description="highest speed of the reference"
    )
    acceleration_max_rad_per_s2: Annotated[Number, Quantity("rad_per_s2", 0.0, 1e12, open_low=True)] = Field(
        default=1e5, description="highest acceleration of the reference"
    )
    max_sample_age_s: Annotated[Number, Quantity("s", 1e-4, 1.0)] = Field(
        default=3e-3, description="no reference is computed from an older sample"
    )
    jerk_max_rad_per_s3: Annotated[Number, Quantity("rad_per_s3", 0.0, 1e18, open_low=True)] | None = Field(
        default=None,
        description="highest jerk of the reference; absent: not limited, for references from a coarse encoder jerk",
    )
    window_travel_max_rad: Annotated[Number, Quantity("rad", 0.0, 1600.0, open_low=True)] | None = Field(
        default=None, description="how far the reference may move within any 250 ms; absent: not limited"
    )
    tension_max_N: Annotated[Number, Quantity("N", 0.0, 1e5, open_low=True)] | None = Field(
        default=None,
        description="highest tension of the wire, by the balance of the motor's torque; beyond it the reference is "
        "held, and soon the drive disabled; absent: not limited",
    )
    current_max_A: Annotated[Number, Quantity("A", 0.0, 200.0, open_low=True)] | None = Field(
        default=None, description="highest measured current, likewise; absent: not limited"
    )
    following_error_max_rad: Annotated[Number, Quantity("rad", 0.0, 1600.0, open_low=True)] | None = Field(
        default=None,
        description="largest distance between motor angle and reference; beyond it the drive is disabled; absent: "
        "not limited",
    )


class Recording(Section):
    """What recordings of this rig don't say themselves."""

    rated_torque_N_m: Annotated[Number, Quantity("N_m", 0.0, 1e3, open_low=True)] | None = Field(
        default=None, description="the motor's rated torque, which drives give torque in percent of (CiA 402, 6076h)"
    )
    constant_load_N_m: Annotated[Number, Quantity("N_m", -10.0, 10.0)] | None = Field(
        default=None, description="load on the jaw in runs without a load cell, where it is known and constant"
    )


def _turning(ratio: float) -> float:
    if abs(ratio) < MIN_ENCODER_RATIO:
        raise text_error(
            f"is {ratio:g}, so the encoder would hardly ever turn; give its turns for a turn of the pulley"
        )
    return ratio


def _object(given: str) -> str:
    """Check the name of an object in a CANopen dictionary."""
    if re.fullmatch(r"[0-9A-Fa-f]{4}h:[0-9A-Fa-f]{2}", given) is None:
        raise text_error(f"is {given}; write index and subindex as 30D1h:02")
    return given


def _version(given: object) -> object:
    """Take a version for a text, where a file has it as a number."""
    return str(given) if isinstance(given, float) else given


MIN_ENCODER_RATIO = 1e-4  # turns of an encoder for a turn of the pulley, of either sign

ProfileName = Literal["native", "odrive", "cia402", "mit", "moteus", "dynamixel", "vesc"]
MitVariant = Literal["bgkatz", "cubemars", "damiao"]


class MotorDriver(Section):
    """The motor driver, where it speaks its maker's protocol (docs/drives.md)."""

    profile: ProfileName = Field(description="what it speaks; `native` is docs/protocol.md")
    firmware: Annotated[Literal["0.5", "0.6"], BeforeValidator(_version)] = Field(
        default="0.6", description="of an ODrive"
    )
    node_id: Annotated[Whole, Quantity("", 0, 252)] = Field(
        default=1,
        description="its node on the bus, or a Dynamixel's id; an ODrive's is 62 at most, a CANopen node's 126",
    )
    encoder_rev_per_pulley_rev: Annotated[Number, Quantity("", -1e4, 1e4), AfterValidator(_turning)] = Field(
        default=1.0, description="turns of the encoder for a turn of the motor pulley; negative: it counts backwards"
    )
    encoder_zero_rev: Annotated[Number, Quantity("", -1e6, 1e6)] = Field(
        default=0.0, description="what the drive calls the angle 0 of the motor pulley, in turns of its encoder"
    )
    feedback_period_s: Annotated[Number, Quantity("s", 1e-4, 0.1)] = Field(
        default=1e-3, description="period of an ODrive's encoder frames, as it is set in the drive"
    )
    current_period_s: Annotated[Number, Quantity("s", 1e-4, 0.1)] = Field(
        default=1e-3, description="period of an ODrive's current frames, as it is set in the drive"
    )
    current_limit_A: Annotated[Number, Quantity("A", 0.0, 200.0, open_low=True)] = Field(
        default=1.0,
        description="what an ODrive or a Dynamixel is told to limit its current to, and a moteus as the torque that it "
        "makes",
    )
    current_object: Annotated[str, AfterValidator(_object)] = Field(
        default="30D1h:02", description="object of a CiA 402 drive with the measured current; 30D1h:02 is an EPOS4's"
    )
    current_object_bits: Literal[16, 32] = Field(default=32, description="size of `current_object`")
    current_lsb_A: Annotated[Number, Quantity("A", 0.0, 10.0, open_low=True)] = Field(
        default=1e-3,
        description="unit of `current_object`; of 6078h it is a thousandth of the rated current (6075h, in mA)",
    )
    watchdog_s: Annotated[Number, Quantity("s", 0.0, 10.0)] = Field(
        default=0.1,
        description="its watchdog's time, 0: off; set in an ODrive, a mini cheetah drive or a VESC (its timeout), "
        "written to a CiA 402 drive (1016h), a moteus and a Dynamixel",
    )
    mit_variant: MitVariant | None = Field(default=None, description="firmware of a mini cheetah drive (`mit`)")
    reply_id: Annotated[Whole, Quantity("", 0, 0x7FF)] | None = Field(
        default=None,
        description="`mit`: id of its answers; absent: 0, the default of bgkatz and DaMiao, or a CubeMars' own node",
    )
    position_range_rad: Annotated[Number, Quantity("rad", 0.0, 1e4, open_low=True)] | None = Field(
        default=None, description="`mit`: ± range of its position field (P_MAX), as it is set in the drive"
    )
    speed_range_rad_per_s: Annotated[Number, Quantity("rad_per_s", 0.0, 1e5, open_low=True)] | None = Field(
        default=None, description="`mit`: ± range of its speed field (V_MAX)"
    )
    kp_range_N_m_per_rad: Annotated[Number, Quantity("N_m_per_rad", 0.0, 1e5, open_low=True)] | None = Field(
        default=None, description="`mit`: range of its kp field, from 0 (KP_MAX)"
    )
    kd_range_N_m_s_per_rad: Annotated[Number, Quantity("N_m_s_per_rad", 0.0, 1e4, open_low=True)] | None = Field(
        default=None, description="`mit`: range of its kd field, from 0 (KD_MAX)"
    )
    torque_range_N_m: Annotated[Number, Quantity("N_m", 0.0, 1e4, open_low=True)] | None = Field(
        default=None, description="`mit`: ± range of its torque field (T_MAX; bgkatz: I_MAX KT GR), and of the answer's"
    )
    feedback_current_range_A: Annotated[Number, Quantity("A", 0.0, 1e3, open_low=True)] | None = Field(
        default=None, description="`mit`: ± range of the answer's last field where the firmware tells a current there"
    )
    kp_N_m_per_rad: Annotated[Number, Quantity("N_m_per_rad", 0.0, 1e5, open_low=True)] | None = Field(
        default=None, description="`mit`: stiffness that is sent with references, of the drive's own shaft"
    )
    kd_N_m_s_per_rad: Annotated[Number, Quantity("N_m_s_per_rad", 0.0, 1e4, open_low=True)] | None = Field(
        default=None, description="`mit`: damping that is sent with references, towards no speed"
    )
    baudrate_bit_per_s: Annotated[Whole, Quantity("bit_per_s", 9_600, 4_500_000)] = Field(
        default=1_000_000, description="rate of a serial line, as it is set in a Dynamixel"
    )


class EstimatorSettings(Section):
    """Tuning of the estimators."""

    rfob_cutoff_Hz: Annotated[Number, Quantity("Hz", 0.0, 1e5, open_low=True)] = Field(
        default=70.0, description="corner of the reaction force observer's low-pass, g_r = 2π times it"
    )


Effects = Annotated[dict[str, dict[str, Number]], BeforeValidator(check_effects)]
