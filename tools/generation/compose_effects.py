"""Put the model and the simulated world together from the files of their effects; with `--check` only compare.

Each effect is one file in `hil_forceps/effects` and one in `virtual_bus/effects`. The names of its functions tell where
it acts: each is one of the ports below. The names of their arguments tell what they need: parameters of the effect,
numbers of the plant, and what the port hands over. Written are `hil_forceps/model/composition.py` and
`virtual_bus/effects/composition.py`: all numbers in one flat tuple, and each port as a sum.
"""

import inspect
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

from hil_forceps.rig.catalogue import EFFECTS, MODULES, Effect

ROOT = Path(__file__).resolve().parents[2]


class Port(NamedTuple):
    """A sum over effects: where it begins, and what each effect may ask for besides its own parameters."""

    name: str
    summary: str
    begins: str
    hands_over: tuple[str, ...]
    composed: str = ""  # name of the sum, where it is another
    takes_plant: bool = True


class Side(NamedTuple):
    """The model or the world: where its effects are, what is written, and its ports."""

    package: str  # of the effects
    target: str
    numbers: str  # the flat tuple's name
    head: str
    plant: dict[str, str]  # numbers of the plant by the names that effects ask for, as expressions
    plant_fields: tuple[str, ...]  # in front of the flat tuple
    receives: str  # first arguments of every port
    decorator: str
    ports: tuple[Port, ...]


MODEL = Side(
    "hil_forceps.effects",
    "hil_forceps/model/composition.py",
    "Physics",
    '"""The plant\'s numbers, and the sums over all effects at each place where they act.\n\n'
    'Written by tools/generation/compose_effects.py from the files in `hil_forceps/effects`; not to be edited.\n"""\n\n'
    "from typing import NamedTuple\n\n{imports}\nfrom hil_forceps.model.kernel import inlined\n",
    {name: f"p.{name}" for name in ("r_m", "r_j", "I_m", "I_j", "D_m", "k", "K_t")},
    ("r_m", "r_j", "I_m", "I_j", "D_m", "motor_coulomb", "jaw_coulomb", "k", "K_t"),
    "p: Physics",
    "inlined",
    (
        Port(
            "motor_friction_N_m",
            "the level of the motor's dry friction at a speed, the same in both directions",
            "p.motor_coulomb",
            ("omega_m_rad_per_s", "tension_N"),
        ),
        Port("motor_friction_at_rest_N_m", "the same at standstill", "p.motor_coulomb", ("tension_N",)),
        Port("forward_friction_N_m", "by how much more a positive speed of the motor is braked", "0.0", ()),
        Port("backward_friction_N_m", "by how much more a negative speed of the motor is braked", "0.0", ()),
        Port("motor_viscosity_N_m_s_per_rad", "D at a time, the mean of both directions", "p.D_m", ("time_s",)),
        Port("motor_drag_N_m", "the torque that brakes one direction of the motor more", "0.0", ("omega_m_rad_per_s",)),
        Port("motor_torque_N_m", "the torque on the motor without current", "0.0", ("theta_m_rad",)),
        Port("relative_torque", "the relative change of the motor's torque with its angle", "0.0", ("theta_m_rad",)),
        Port("relative_torque_constant", "the relative change of K_t at a time", "0.0", ("time_s",)),
        Port("wound_m", "the wire wound up from angle 0 on", "p.r_m * theta_p_rad", ("theta_p_rad",)),
        Port("radius_m", "the effective radius of the motor pulley", "p.r_m", ("theta_p_rad",)),
        Port("paid_m", "the wire that the jaw takes from angle 0 on", "p.r_j * theta_j_rad", ("theta_j_rad",)),
        Port("lever_m", "the lever at which the wire pulls the jaw", "p.r_j", ("theta_j_rad",)),
        Port("jaw_load_N_m", "the load on the jaw that depends on its angle", "0.0", ("theta_j_rad",)),
        Port(
            "jaw_friction_N_m",
            "the level of the jaw's dry friction; below 0 there is none",
            "p.jaw_coulomb",
            ("theta_j_rad",),
        ),
        Port(
            "encoder_error_rad",
            "the angle that the encoder shows, before quantisation",
            "theta_m_rad",
            ("theta_m_rad",),
            "encoder_rad",
        ),
    ),
)
WORLD = Side(
    "virtual_bus.effects",
    "virtual_bus/effects/composition.py",
    "EffectNumbers",
    '"""Numbers of all effects, and the sums over them at each place where they act.\n\n'
    'Written by tools/generation/compose_effects.py from the files in `virtual_bus/effects`; not to be edited.\n"""\n\n'
    "from typing import NamedTuple\n\n{imports}\nfrom virtual_bus.kernel import subroutine\n"
    "from virtual_bus.plant.plant import TruthParameters\n",
    {"r_m": "p.motor_pulley_radius_m", "r_j": "p.jaw_pulley_radius_m"},
    (),
    "p: TruthParameters, e: EffectNumbers",
    "subroutine",
    (
        Port(
            "motor_friction_N_m",
            "the motor's dry friction against motion to one side",
            "p.motor_coulomb_N_m",
            ("side", "omega_m_rad_per_s", "tension_N"),
        ),
        Port("motor_drag_N_m", "what else brakes the motor at a speed", "0.0", ("omega_m_rad_per_s",)),
        Port("motor_torque_N_m", "the torque on the motor that comes without current", "0.0", ("theta_m_rad",)),
        Port("relative_torque", "the relative change of the motor's torque with its angle", "0.0", ("theta_m_rad",)),
        Port("relative_torque_constant", "the relative change of K_t at a time", "0.0", ("time_s",)),
        Port("relative_viscosity", "the relative change of the motor's viscous friction", "0.0", ("time_s",)),
        Port("wound_m", "the wire wound up from angle 0 on", "p.motor_pulley_radius_m * theta_p_rad", ("theta_p_rad",)),
        Port("radius_m", "the effective radius of the motor pulley", "p.motor_pulley_radius_m", ("theta_p_rad",)),
        Port("taken_m", "the wire that the jaw has taken", "p.jaw_pulley_radius_m * theta_j_rad", ("theta_j_rad",)),
        Port("lever_m", "the lever at which the wire pulls the jaw", "p.jaw_pulley_radius_m", ("theta_j_rad",)),
        Port("jaw_load_N_m", "what acts on the jaw beside τ_w", "0.0", ("theta_j_rad", "omega_j_rad_per_s")),
        Port("jaw_friction_N_m", "the jaw's dry friction, as long as it is any", "p.jaw_coulomb_N_m", ("theta_j_rad",)),
        Port(
            "encoder_error_rad",
            "θ_enc before it is counted",
            "theta_m_rad",
            ("theta_m_rad",),
            "encoder_angle",
            takes_plant=False,
        ),
    ),
)
SIDES = (MODEL, WORLD)


def main(arguments: list[str]) -> int:
    """Write both files, or with `--check` tell whether they are up to date."""
    status = 0
    for side in SIDES:
        target = ROOT / side.target
        text = formatted(render(side))
        if arguments == ["--check"]:
            if not target.exists() or target.read_text(encoding="utf-8") != text:
                print(f"{target} is out of date; run make effects")
                status = 1
        else:
            target.write_text(text, encoding="utf-8")
    return status


def render(side: Side) -> str:
    """Return the file of one side."""
    modules = {effect.id: module for effect in EFFECTS if (module := _module(side, effect)) is not None}
    imports = "\n".join(_imports(side))
    parts = [side.head.replace("{imports}", imports), *_compiled(side, modules), "", *_numbers(side)]
    for port in side.ports:
        parts += ["", *_port(side, port, modules)]
    if side is MODEL:
        parts += [*_changes(), *_without_dry_friction(side)]
    return "\n".join(parts) + "\n"


def formatted(text: str) -> str:
    """Return the text as the house formats it."""
    ruff = Path(sys.executable).with_name("ruff")
    for arguments in (("check", "--select", "I", "--fix", "--quiet"), ("format", "--quiet")):
        command = [str(ruff), *arguments, "--stdin-filename", str(ROOT / "hil_forceps" / "x.py"), "-"]
        text = subprocess.run(command, input=text, capture_output=True, text=True, check=True, cwd=ROOT).stdout
    return text


def _module(side: Side, effect: Effect) -> ModuleType | None:
    """Return an effect's file; the world has none for what is built into its wire, its memories and its sensors."""
    name = f"{side.package}.{_room(effect)}.{effect.id}"
    return import_module(name) if find_spec(name) is not None else None


def _room(effect: Effect) -> str:
    return MODULES[effect.id].split(".")[-2]


def _imports(side: Side) -> Iterator[str]:
    rooms: dict[str, list[str]] = {}
    for effect in EFFECTS:
        if any(_functions(side, port, effect) for port in side.ports):
            rooms.setdefault(_room(effect), []).append(effect.id)
    for room, ids in sorted(rooms.items()):
        yield f"from {side.package}.{room} import {', '.join(sorted(ids))}"


def _functions(side: Side, port: Port, effect: Effect) -> Callable[..., float] | None:
    found: Callable[..., float] | None = getattr(_module(side, effect), port.name, None)
    return found


def _compiled(side: Side, modules: dict[str, ModuleType]) -> Iterator[str]:
    for port in side.ports:
        for effect_id, module in modules.items():
            if hasattr(module, port.name):
                yield f"_{effect_id}__{port.name} = {side.decorator}({effect_id}.{port.name})"


def _numbers(side: Side) -> Iterator[str]:
    yield f"\nclass {side.numbers}(NamedTuple):"
    first = "Numbers of the plant, then e" if side.plant_fields else "E"
    yield f'    """{first}very parameter of every effect in the order of the catalogue; SI."""\n'
    for name in side.plant_fields:
        yield f"    {name}: float"
    for effect in EFFECTS:
        for parameter in effect.parameters:
            yield f"    {effect.id}_{parameter.name}: float"
    yield ""


def _port(side: Side, port: Port, modules: dict[str, ModuleType]) -> Iterator[str]:
    arguments = "".join(f", {name}: float" for name in port.hands_over)
    receives = side.receives if port.takes_plant else side.receives.split(", ")[-1]
    yield f"\n@{side.decorator}"
    yield f"def {port.composed or port.name}({receives}{arguments}) -> float:"
    yield f'    """Return {port.summary}."""'
    yield f"    total = {port.begins}"
    for effect in EFFECTS:
        function = getattr(modules.get(effect.id), port.name, None)
        if function is not None:
            yield f"    total += _{effect.id}__{port.name}({', '.join(_arguments(side, port, effect, function))})"
    yield "    return total"


def _arguments(side: Side, port: Port, effect: Effect, function: Callable[..., float]) -> Iterator[str]:
    own = {parameter.name for parameter in effect.parameters}
    for name in inspect.signature(function).parameters:
        if name in own:
            yield f"{'p' if side is MODEL else 'e'}.{effect.id}_{name}"
        elif name in port.hands_over:
            yield name
        elif name in side.plant:
            yield side.plant[name]
        else:
            known = ", ".join(sorted((*own, *port.hands_over, *side.plant)))
            raise SystemExit(f"{function.__module__}.{port.name}: nothing is called {name} there; there are {known}")


def _changes() -> Iterator[str]:
    kinds: Sequence[tuple[str, str, str]] = (
        ("friction", "level_changes", "the level of dry friction"),
        ("torque", "torque_changes", "torques on the motor or the jaw"),
        ("wire", "wire_changes", "the law of the wire or what winds it"),
    )
    for kind, name, words in kinds:
        amplitudes = [
            f"abs(p.{effect.id}_{parameter.name})"
            for effect in EFFECTS
            if effect.changes == kind
            for parameter in effect.parameters
            if parameter.neutral is not None
        ]
        yield "\n\n@inlined"
        yield f"def {name}(p: Physics) -> float:"
        yield f'    """Return 0 where no effect changes {words}."""'
        yield "    total = 0.0"
        for amplitude in amplitudes:
            yield f"    total += {amplitude}"
        yield "    return total"


def _without_dry_friction(side: Side) -> Iterator[str]:
    values = [
        f"{name.removesuffix('_coulomb')}_kept * p.{name}" if name.endswith("_coulomb") else f"p.{name}"
        for name in side.plant_fields
    ]
    for effect in EFFECTS:
        for parameter in effect.parameters:
            name = f"p.{effect.id}_{parameter.name}"
            if effect.dry_friction_of is not None and parameter.neutral is not None:
                if parameter.neutral != 0.0:
                    raise SystemExit(f"{effect.id}.{parameter.name}: dry friction is off at 0, not {parameter.neutral}")
                name = f"{effect.dry_friction_of}_kept * {name}"
            values.append(name)
    yield "\n\n@inlined"
    yield f"def without_dry_friction(p: {side.numbers}, motor: bool, jaw: bool) -> {side.numbers}:"
    yield '    """Return the plant without what holds its motor, its jaw or both at rest."""'
    yield "    motor_kept, jaw_kept = 0.0 if motor else 1.0, 0.0 if jaw else 1.0"
    yield f"    return {side.numbers}("
    for value in values:
        yield f"        {value},"
    yield "    )"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
