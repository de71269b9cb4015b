"""The C text of a unit: its kernels, translated, and the tables of its variables (`unit.h`)."""

import hashlib
from importlib import resources

from hil_forceps import __version__
from hil_forceps.fmu.unit import Unit, Variable
from hil_forceps.kernels.translation.numbers import number
from hil_forceps.kernels.translation.program import Translation
from hil_forceps.kernels.translation.types import INT, Array

_KERNEL_TYPES = (Array(1), Array(1), INT)
_OF_VERSION = {2: ("fmi2.c",), 3: ("fmi3.c", "fmi3_not_offered.h")}


def sources(unit: Unit, fmi: int) -> tuple[dict[str, str], str]:
    """Return a unit's files of C for a version of the standard, by name, and the token that tells it from others.

    The first file is the one to compile; the standard's own headers are not among them.
    """
    kernels = Translation()
    for name in ("begin", "prepare", "advance"):
        kernels.entry(getattr(unit, name), _KERNEL_TYPES, f"hf_{name}")
    tables = _tables(unit)
    own = {name: _own("hil_forceps.fmu", f"c/{name}") for name in (*_OF_VERSION[fmi], "instance.h")}
    own["arrays.h"] = _own("hil_forceps.kernels", "arrays.h")
    text = kernels.text()
    digest = hashlib.blake2b("\0".join([unit.name, tables, text, *own.values()]).encode(), digest_size=16).hexdigest()
    token = f"{digest[:8]}-{digest[8:12]}-{digest[12:16]}-{digest[16:20]}-{digest[20:]}"
    head = [
        f"/* {unit.name}: written by hil-forceps {__version__} out of the kernels that it simulates with itself. */",
        "#ifndef HF_UNIT_H\n#define HF_UNIT_H\n",
        '#include "arrays.h"\n',
        f'#define HF_TOKEN "{{{token}}}"',
        f"#define HF_VALUES {len(unit.variables)}",
        f"#define HF_MEMORY {unit.memory_size}",
        f"#define HF_SAMPLE_TIME_PLACE ({unit.sample_time_place})\n",
    ]
    unit_h = "\n".join([*head, tables, text, "#endif\n"])
    return {**own, "unit.h": unit_h}, f"{{{token}}}"


def _own(package: str, path: str) -> str:
    return resources.files(package).joinpath(path).read_text(encoding="utf-8")


def _tables(unit: Unit) -> str:
    variables = unit.variables
    return "\n".join(
        [
            _table("double", "starts", [number(each.start) for each in variables]),
            _table("double", "minima", [number(each.minimum) for each in variables]),
            _table("double", "maxima", [number(each.maximum) for each in variables]),
            _table("char", "kinds", [f"'{each.kind[0]}'" for each in variables]),
            _table("char", "roles", [f"'{_role(each)}'" for each in variables]),
            _table("char *const", "names", [f'"{each.name}"' for each in variables]),
            _table("char *const", "problems", [f'"{problem}"' for problem in unit.problems]),
        ]
    )


def _table(kind: str, name: str, values: list[str]) -> str:
    return f"static const {kind} hf_{name}[] = {{\n    " + ",\n    ".join(values) + "};\n"


def _role(variable: Variable) -> str:
    """Return who may set it when: i an input, t always, f until the start, o nobody."""
    if variable.causality == "input":
        return "i"
    if variable.causality != "parameter":
        return "o"
    return "t" if variable.variability == "tunable" else "f"
