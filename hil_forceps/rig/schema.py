"""The rig: what a rig file holds, as frozen models whose attributes are the file's keys. All SI.

Every key has its unit and range of sense in its `Quantity` and its meaning in its description; `docs/rig-file.md` is
generated from them. A rig built or changed in code passes the same checks as one read from a file.
"""

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    Field,
    ValidationError,
    field_serializer,
    model_validator,
)
from pydantic_core import PydanticCustomError

from hil_forceps.rig import consistency
from hil_forceps.rig.catalogue import EFFECT_IDS
from hil_forceps.rig.errors import UserError
from hil_forceps.rig.plant import PlantParameters
from hil_forceps.rig.problems import Problem, nearest, problems_error, show_path
from hil_forceps.rig.quantities import STRICT, Number, Parameter, Quantity, Whole
from hil_forceps.rig.translation import problems_of

AlgorithmId = Literal["previous", "improved_as_published", "improved", "kalman"]
ALGORITHM_IDS: tuple[AlgorithmId, ...] = ("previous", "improved_as_published", "improved", "kalman")
IDEAL = "ideal"
MAX_NODE_ID = 30
MAX_ENCODER_COUNTS = 1 << 24  # what the wire resolves

_Radius = Annotated[Parameter, Quantity("m", 0.0, 0.2, open_low=True)]
_Inertia = Annotated[Parameter, Quantity("kg_m2", 0.0, 1e-2, open_low=True)]
_Friction = Annotated[Parameter, Quantity("N_m", 0.0, 10.0)]
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
        text = f"is {given!r}; give the counts of a revolution or {IDEAL}"
        raise PydanticCustomError("counts", "{text}", {"text": text})
    return given


class Encoder(Section):
    """The encoder on the motor pulley."""

    counts_per_rev: Annotated[
        Annotated[Whole, Quantity("", 4, MAX_ENCODER_COUNTS)] | None, BeforeValidator(_read_counts)
    ] = Field(
        description=f"counts of a revolution after quadrature; `{IDEAL}`: no quantisation but the wire's 2⁻²⁴ turn"
    )

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


class Noise(Section):
    """Standard deviations of the sensors where known; the simulated world takes 0 where a key is absent."""

    current_A: Annotated[Number, Quantity("A", 0.0, 10.0)] = Field(default=0.0, description="of the measured current")
    theta_j_rad: Annotated[Number, Quantity("rad", 0.0, 0.5)] = Field(
        default=0.0, description="of the bench's jaw sensor"
    )
    tau_w_N_m: Annotated[Number, Quantity("N_m", 0.0, 1.0)] = Field(default=0.0, description="of the bench's load cell")


def _no_repeats(given: tuple[object, ...]) -> tuple[object, ...]:
    if len(set(given)) != len(given):
        raise PydanticCustomError("repeats", "{text}", {"text": "names an entry twice; keep one of them"})
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
    algorithms: Annotated[tuple[AlgorithmId, ...], _LIST, AfterValidator(_no_repeats)] = Field(
        default=ALGORITHM_IDS, description="estimators to run"
    )
    simulations: Annotated[tuple[Literal[1, 2], ...], _LIST, AfterValidator(_no_repeats)] = Field(
        default=(1, 2), description="the paper's simulations to run"
    )
    direct_sample_times_s: Annotated[
        tuple[Annotated[Number, Quantity("s", 1e-6, 0.1)], ...], _LIST, AfterValidator(_no_repeats)
    ] = Field(default=(1e-4,), description="sample times at which estimators are also fed without the bus")
    plant_step_s: Annotated[Number, Quantity("s", 1e-7, 1e-2)] = Field(
        default=5e-5, description="step of the simulated plant"
    )


class Limits(Section):
    """What the gate lets pass to the drive: the last stage before any reference leaves."""

    position_min_rad: _Position = Field(default=-1.0, description="lowest motor angle")
    position_max_rad: _Position = Field(default=7.0, description="highest motor angle")
    speed_max_rad_per_s: Annotated[Number, Quantity("rad_per_s", 0.0, 1e6, open_low=True)] = Field(
        default=200.0, description="highest speed of the reference"
    )
    acceleration_max_rad_per_s2: Annotated[Number, Quantity("rad_per_s2", 0.0, 1e12, open_low=True)] = Field(
        default=1e5, description="highest acceleration of the reference"
    )
    max_sample_age_s: Annotated[Number, Quantity("s", 1e-4, 1.0)] = Field(
        default=3e-3, description="no reference is computed from an older sample"
    )


class EstimatorSettings(Section):
    """Tuning of the estimators."""

    rfob_cutoff_Hz: Annotated[Number, Quantity("Hz", 0.0, 1e5, open_low=True)] = Field(
        default=70.0, description="corner of the reaction force observer's low-pass, g_r = 2π times it"
    )


def _check_effect_id(given: str) -> str:
    if given not in EFFECT_IDS:
        guess = nearest(given, EFFECT_IDS)
        remedy = f"did you mean {guess}?" if guess else "see docs/rig-file.md for the ids"
        text = f"is no effect of the catalogue; {remedy}"
        raise PydanticCustomError("effect_id", "{text}", {"text": text})
    return given


EffectId = Annotated[str, AfterValidator(_check_effect_id)]
ParameterName = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,79}$")]


class Rig(Section):
    """A rig file: what is known of a forceps with its motor and drive, and how the bench runs it."""

    forceps: Forceps
    motor: Motor
    encoder: Encoder
    drive: DriveLaw | None = None
    noise: Noise = Noise()
    effects: dict[EffectId, dict[ParameterName, Number]] = {}
    bench: BenchSettings = BenchSettings()
    limits: Limits = Limits()
    estimators: EstimatorSettings = EstimatorSettings()

    @model_validator(mode="after")
    def _check_consistency(self) -> Self:
        if problems := consistency.check(consistency.flatten(self.to_data(), type(self))):
            raise problems_error(problems)
        return self

    def __hash__(self) -> int:
        # Without the effects, whose mappings can't be hashed: equal rigs still have equal hashes.
        return hash((self.forceps, self.motor, self.encoder, self.drive, self.noise, self.bench, self.limits))

    def to_data(self) -> dict[str, Any]:
        """Return what was given, as plain data in the form that a rig file has."""
        return self.model_dump(by_alias=True, exclude_unset=True)

    def with_changes(self, changes: Mapping[str, object]) -> "Rig":
        """Return a rig with other values, checked as a whole.

        `changes` maps dotted keys to values as a file gives them (`{"encoder.counts_per_rev": 4096, "effects": {}}`);
        a whole section may be given as a mapping, and None removes a key, so that its default holds. UserError when
        the result is no valid rig.
        """
        data = {key: dict(value) if isinstance(value, dict) else value for key, value in self.to_data().items()}
        for dotted, value in changes.items():
            section, _, key = dotted.partition(".")
            target = data.setdefault(section, {}) if key else data
            plain = list(value) if isinstance(value, tuple) else value
            if plain is None:
                target.pop(key or section, None)
            else:
                target[key or section] = plain
        return rig_from_data(data)

    def plant(self) -> PlantParameters:
        """Return the values of the plant; UserError naming every one that isn't known."""
        named = {f"forceps.{key}": getattr(self.forceps, key) for key in type(self.forceps).model_fields}
        named |= {f"motor.{key}": getattr(self.motor, key) for key in type(self.motor).model_fields}
        unknown = [key for key, parameter in named.items() if parameter.value is None]
        if unknown:
            raise UserError([f"{key}: its value isn't known and is needed here; give a value" for key in unknown])
        return PlantParameters(**{key.partition(".")[2]: parameter.value for key, parameter in named.items()})

    def require_no_effects(self) -> None:
        """UserError when the rig has effects: for callers that can't simulate them and must not pass them over."""
        if self.effects:
            raise UserError(
                [
                    f"effects.{name}: can't be simulated by this version; remove it to run without"
                    for name in self.effects
                ]
            )

    def require_drive(self) -> DriveLaw:
        """Return the drive's law; UserError when the rig has none."""
        if self.drive is None:
            raise UserError("drive: the section is missing and the closed loop can't be simulated without; add it")
        return self.drive

    def require_bench(self) -> None:
        """UserError with all that keeps a bench from running this rig: no drive, effects, unknown values, no time.

        A rig needs none of this to be a rig: a file without `bench:` may have a drive too fast for the default bus.
        """
        problems: list[str] = []
        for need in (self.plant, self.require_drive, self.require_no_effects):
            try:
                need()
            except UserError as error:
                problems += error.problems
        found = consistency.check_bench(consistency.flatten(self.to_data(), type(self)))
        if problems := [*problems, *map(_without_place, found)]:
            raise UserError(problems)


def _without_place(problem: Problem) -> str:
    return f"{show_path(problem.path)}: {problem.text}" if problem.path else problem.text


def rig_from_data(data: Mapping[str, object]) -> Rig:
    """Validate plain data in the form of a rig file; UserError with every problem, without places in a file."""
    rig, problems = validate(data)
    if rig is None:
        raise UserError([_without_place(problem) for problem in problems])
    return rig


def validate(data: Mapping[str, object]) -> tuple[Rig | None, list[Problem]]:
    """Validate plain data: a rig, or None and every problem, those between keys included."""
    try:
        return Rig.model_validate(data), []
    except ValidationError as error:
        problems = problems_of(error, Rig)
    problems += consistency.check(consistency.flatten(data, Rig, {problem.path for problem in problems}))
    return None, list(dict.fromkeys(problems))
