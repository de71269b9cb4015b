"""Options of `hil-forceps init`, and the questions for those that were not given."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Annotated, Any, Final

from cyclopts import Group, Parameter

from hil_forceps.cli.arguments.questions import Question, ask, can_ask, missing
from hil_forceps.rig import presets
from hil_forceps.rig.errors import UserError
from hil_forceps.rig.first_rig.answers import Answers, check_pair, own_motor
from hil_forceps.rig.presets import Fact, MotorPreset
from hil_forceps.rig.sections import MAX_ENCODER_COUNTS, MIN_ENCODER_RATIO

OWN: Final = "own"
MAX_RADIUS_MM: Final = 200.0
HARDWARE: Final = Group("Hardware", sort_key=1)
KNOWN: Final = Group("Other known values", sort_key=2)


@Parameter(name="*", group=HARDWARE)
@dataclass(frozen=True)
class Hardware:
    """The hardware: what is not given is asked for on a terminal."""

    motor: Annotated[
        str, Parameter(help="Preset of the motor (--list); own: another motor, with --torque-constant.")
    ] = ""
    drive: Annotated[str, Parameter(help="Drive: native, odrive, cia402, mit, moteus, dynamixel or vesc.")] = ""
    motor_pulley_radius_mm: Annotated[
        float | None, Parameter(help="Radius (not diameter) of the motor pulley, in mm.")
    ] = None
    jaw_pulley_radius_mm: Annotated[float | None, Parameter(help="Radius of the jaw pulley, in mm.")] = None
    gear: Annotated[
        float | None,
        Parameter(
            help="Turns of the motor for one turn of its pulley, negative if they turn opposite ways; default: 1. "
            "The preset of an actuator contains its gear."
        ),
    ] = None
    encoder_counts: Annotated[
        int | None, Parameter(help="Counts of the encoder in one turn, after quadrature decoding.")
    ] = None
    current_limit: Annotated[
        float | None, Parameter(help="Current limit, in A; default: the nominal current of the motor.")
    ] = None
    node_id: Annotated[
        int | None, Parameter(help="Node or id of the drive; default: that of the example of the drive.")
    ] = None


@Parameter(name="*", group=KNOWN)
@dataclass(frozen=True)
class Besides:
    """Other values that are known; never asked for."""

    torque_constant: Annotated[
        float | None, Parameter(help="Torque constant, N m/A, of a motor without a preset.", negative="")
    ] = None
    motor_inertia: Annotated[float | None, Parameter(help="Inertia, kg m², of a motor without a preset.")] = None
    wire_stiffness: Annotated[float | None, Parameter(help="Stiffness of the wire, N/m.")] = None
    tension_max: Annotated[
        float | None,
        Parameter(help="Largest permitted tension of the wire, N; sets the current limit and a limit of the gate."),
    ] = None
    jaw_inertia: Annotated[float | None, Parameter(help="Inertia of jaw and jaw pulley, kg m².")] = None
    jaw_coulomb: Annotated[float | None, Parameter(help="Coulomb friction of the jaw, N m.")] = None
    jaw_min_deg: Annotated[float, Parameter(help="Lowest angle of the jaw, degrees.")] = 0.0
    jaw_max_deg: Annotated[float, Parameter(help="Highest angle of the jaw, degrees.")] = 90.0
    assume: Annotated[
        bool,
        Parameter(
            negative="",
            help="Use the paper's values, or the middle of the bounds, for unknown values. For simulation only, not "
            "for a real motor.",
        ),
    ] = False


def answers_of(hardware: Hardware, besides: Besides) -> Answers:
    """Return all answers, asking for the missing ones; UserError if nobody can be asked."""
    _check_besides(besides)
    found = _Filled(hardware, besides)
    motor, profile = found.motor, found.profile
    check_pair(found.name, motor, profile)
    return Answers(
        motor=motor,
        profile=profile,
        drive=presets.drive_preset(profile),
        motor_pulley_radius_m=found.values["--motor-pulley-radius-mm"] * 1e-3,
        jaw_pulley_radius_m=found.values["--jaw-pulley-radius-mm"] * 1e-3,
        encoder_counts=_fact("--encoder-counts", found.values, motor.values.encoder_counts_per_rev),
        current_limit_A=_fact("--current-limit", found.values, motor.values.nominal_current_A),
        gear=found.values["--gear"],
        node_id=hardware.node_id,
        wire_stiffness_N_per_m=besides.wire_stiffness,
        jaw_inertia_kg_m2=besides.jaw_inertia,
        jaw_coulomb_N_m=besides.jaw_coulomb,
        tension_max_N=besides.tension_max,
        jaw_min_rad=math.radians(besides.jaw_min_deg),
        jaw_max_rad=math.radians(besides.jaw_max_deg),
        assume=besides.assume,
    )


class _Filled:
    """Asks for motor and drive first, because the further questions depend on them."""

    def __init__(self, hardware: Hardware, besides: Besides) -> None:
        self._asks = can_ask()
        first = list(_first_questions(hardware, besides))
        if first and not self._asks:
            preset = presets.motors().get(hardware.motor)
            raise missing([*first, *_open(list(_questions(hardware, preset)))])
        said = {each.option: ask(each) for each in first}
        self.name = hardware.motor or said.get("--motor NAME", OWN)
        self.motor: MotorPreset = self._own(besides, said) if self.name == OWN else presets.motor_preset(self.name)
        self.profile = hardware.drive or self.motor.drive or self._one(_DRIVE)
        presets.drive_preset(self.profile)
        questions = list(_questions(hardware, self.motor))
        if not self._asks and (still := _open(questions)):
            raise missing(still)
        self.values: dict[str, Any] = _given(hardware)
        for each in questions:
            self.values[each.option.partition(" ")[0]] = ask(each) if self._asks else each.read(each.default)

    def _own(self, besides: Besides, said: dict[str, Any]) -> MotorPreset:
        constant = besides.torque_constant or said.get(_TORQUE_CONSTANT.option) or self._one(_TORQUE_CONSTANT)
        return own_motor(constant, besides.motor_inertia)

    def _one(self, question: Question[Any]) -> Any:
        if not self._asks:
            raise missing([question])
        return ask(question)


def _open(questions: list[Question[Any]]) -> list[Question[Any]]:
    return [each for each in questions if not each.default]


def _first_questions(hardware: Hardware, besides: Besides) -> Iterator[Question[Any]]:
    names = f"Motor, {', '.join(presets.motors())}, or {OWN} for another"
    motor = presets.motors().get(hardware.motor)
    if not hardware.motor and besides.torque_constant is None:
        yield Question("--motor NAME", names, _motor_name)
    elif hardware.motor == OWN and besides.torque_constant is None:
        yield _TORQUE_CONSTANT
    if not hardware.drive and (motor is None or motor.drive is None) and not can_ask():
        yield _DRIVE


def _given(hardware: Hardware) -> dict[str, Any]:
    return {
        "--motor-pulley-radius-mm": _checked(hardware.motor_pulley_radius_mm, _radius),
        "--jaw-pulley-radius-mm": _checked(hardware.jaw_pulley_radius_mm, _radius),
        "--gear": _checked(hardware.gear, _gear),
        "--encoder-counts": _checked(hardware.encoder_counts, _counts),
        "--current-limit": _checked(hardware.current_limit, _positive("the current, in A")),
    }


def _checked(given: float | None, read: Callable[[str], Any]) -> Any:
    return None if given is None else read(str(given))


def _questions(hardware: Hardware, motor: MotorPreset | None) -> Iterator[Question[Any]]:
    """Yield the open questions, with the motor preset's values as defaults."""
    counts = motor and motor.values.encoder_counts_per_rev
    limit = motor and motor.values.nominal_current_A
    given = _given(hardware)
    for question in (
        Question("--motor-pulley-radius-mm R", "Radius (not diameter) of the motor pulley, mm", _radius),
        Question("--jaw-pulley-radius-mm R", "Radius of the jaw pulley, mm", _radius),
        Question("--gear N", "Turns of the motor for one turn of its pulley", _gear, "1"),
        Question(
            "--encoder-counts N", "Counts of the encoder in one turn", _counts, str(counts.value) if counts else ""
        ),
        Question(
            "--current-limit A",
            "Current limit, A",
            _positive("the current, in A"),
            str(limit.value) if limit else "",
        ),
    ):
        if given[question.option.partition(" ")[0]] is None:
            yield question


def _motor_name(text: str) -> str:
    if text != OWN:
        presets.motor_preset(text)
    return text


def _drive_name(text: str) -> str:
    presets.drive_preset(text)
    return text


def _number(text: str, meant: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise UserError(f"{text}: must be a number, {meant}")
    return number


def _positive(meant: str) -> Callable[[str], float]:
    def read(text: str) -> float:
        number = _number(text, meant)
        if number <= 0.0:
            raise UserError(f"{text}: must be above 0, {meant}")
        return number

    return read


def _radius(text: str) -> float:
    number = _positive("the radius in mm")(text)
    if number > MAX_RADIUS_MM:
        raise UserError(f"{text}: must be at most {MAX_RADIUS_MM:g}, the radius in mm")
    return number


def _gear(text: str) -> float:
    number = _number(text, "turns of the motor for one turn of the pulley")
    if not MIN_ENCODER_RATIO <= abs(number) <= 1.0 / MIN_ENCODER_RATIO:
        raise UserError(
            f"{text}: must be {MIN_ENCODER_RATIO:g} to {1.0 / MIN_ENCODER_RATIO:g} or negative, turns of the motor for "
            "one turn of the pulley"
        )
    return number


def _counts(text: str) -> int:
    number = _number(text, "counts in one turn")
    if not (number.is_integer() and 4 <= number <= MAX_ENCODER_COUNTS):
        raise UserError(f"{text}: must be a whole number of counts, 4 to {MAX_ENCODER_COUNTS}")
    return int(number)


def _fact(option: str, values: dict[str, Any], known: Fact | None) -> Fact:
    value = values[option]
    if known is not None and float(known.value) == float(value):
        return known
    return Fact(value=value, source=f"given with {option}")


def _check_besides(besides: Besides) -> None:
    for option, given in (
        ("--torque-constant", besides.torque_constant),
        ("--motor-inertia", besides.motor_inertia),
        ("--wire-stiffness", besides.wire_stiffness),
        ("--tension-max", besides.tension_max),
        ("--jaw-inertia", besides.jaw_inertia),
    ):
        if given is not None and not (math.isfinite(given) and given > 0.0):
            raise UserError(f"{option} {given:g}: must be above 0")
    if not besides.jaw_min_deg < besides.jaw_max_deg:
        raise UserError(f"--jaw-min-deg {besides.jaw_min_deg:g}: must be below --jaw-max-deg {besides.jaw_max_deg:g}")


_TORQUE_CONSTANT: Final[Question[Any]] = Question(
    "--torque-constant N_M_PER_A", "Torque constant of the motor, N m/A", _positive("the torque constant, in N m/A")
)
_DRIVE: Final[Question[Any]] = Question("--drive NAME", f"Drive, {', '.join(presets.drives())}", _drive_name)
