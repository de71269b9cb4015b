"""`modelDescription.xml` of a unit, by FMI 2.0 or 3.0, and `buildDescription.xml` of FMI 3.0."""

import math
from xml.etree import ElementTree as Xml

from hil_forceps import __version__
from hil_forceps.fmu.unit import Unit, Variable
from hil_forceps.rig.units import show_unit

_TOOL = f"hil-forceps {__version__}"
_SAVES = {2: ("canGetAndSetFMUstate", "canSerializeFMUstate"), 3: ("canGetAndSetFMUState", "canSerializeFMUState")}
# Exponents of the base units, in the standard's words.
_BASE_UNITS: dict[str, dict[str, int]] = {
    "m": {"m": 1},
    "s": {"s": 1},
    "A": {"A": 1},
    "rad": {"rad": 1},
    "Hz": {"s": -1},
    "N": {"kg": 1, "m": 1, "s": -2},
    "kg": {"kg": 1},
    "turn": {},
}


def model_description(unit: Unit, fmi: int, token: str, sources: list[str], generated: str) -> bytes:
    """Return the description; `sources`: the files to compile, `generated`: when, as the standard writes times."""
    common = {"modelName": unit.name, "description": unit.description, "version": __version__, "generationTool": _TOOL}
    common |= {"generationDateAndTime": generated, "variableNamingConvention": "structured", "license": "Apache-2.0"}
    head = {"fmiVersion": "2.0", "guid": token} if fmi == 2 else {"fmiVersion": "3.0", "instantiationToken": token}
    root = Xml.Element("fmiModelDescription", {**head, **common})
    variable_step = {"canHandleVariableCommunicationStepSize": str(unit.sample_time_place < 0).lower()}
    simulation = {"modelIdentifier": unit.name, **variable_step, **dict.fromkeys(_SAVES[fmi], "true")}
    if fmi == 3 and unit.sample_time_place >= 0:
        simulation["fixedInternalStepSize"] = repr(unit.sample_time_s)
    element = Xml.SubElement(root, "CoSimulation", simulation)
    if fmi == 2:
        files = Xml.SubElement(element, "SourceFiles")
        for name in sources:
            Xml.SubElement(files, "File", {"name": name})
    _units(root, unit)
    categories = Xml.SubElement(root, "LogCategories")
    Xml.SubElement(categories, "Category", {"name": "logStatusError", "description": "what was refused, and why"})
    Xml.SubElement(root, "DefaultExperiment", {"startTime": "0", "stepSize": repr(unit.sample_time_s)})
    variables = Xml.SubElement(root, "ModelVariables")
    for place, variable in enumerate(unit.variables):
        _VARIABLE[fmi](variables, variable, place)
    if fmi == 3:
        independent = {"name": "time", "valueReference": str(len(unit.variables)), "causality": "independent"}
        Xml.SubElement(variables, "Float64", {**independent, "variability": "continuous", "description": "time"})
    _structure(root, unit, fmi)
    return _bytes(root)


def build_description(unit: Unit, sources: list[str]) -> bytes:
    """Return FMI 3.0's description of how to compile the sources."""
    root = Xml.Element("fmiBuildDescription", {"fmiVersion": "3.0"})
    configuration = Xml.SubElement(root, "BuildConfiguration", {"modelIdentifier": unit.name})
    files = Xml.SubElement(configuration, "SourceFileSet", {"language": "C99"})
    for name in sources:
        Xml.SubElement(files, "SourceFile", {"name": name})
    return _bytes(root)


def _bytes(root: Xml.Element) -> bytes:
    Xml.indent(root)
    text: bytes = Xml.tostring(root, encoding="utf-8", xml_declaration=True)
    return text + b"\n"


def _units(root: Xml.Element, unit: Unit) -> None:
    definitions = Xml.SubElement(root, "UnitDefinitions")
    for name in sorted({each.unit for each in unit.variables if each.unit and each.kind == "real"}):
        exponents = _exponents(name)
        element = Xml.SubElement(definitions, "Unit", {"name": show_unit(name)})
        Xml.SubElement(element, "BaseUnit", {base: str(power) for base, power in exponents.items() if power})


def _exponents(unit: str) -> dict[str, int]:
    """Return the exponents of the base units of a unit as rig files write it (`N_m_s_per_rad`)."""
    above, _, below = unit.partition("_per_") if not unit.startswith("per_") else ("", "", unit[4:])
    total: dict[str, int] = {}
    for part, sign in ((above, 1), (below, -1)):
        for symbol in filter(None, part.split("_")):
            power = int(symbol[-1]) if symbol[-1].isdigit() else 1
            for base, each in _BASE_UNITS[symbol.rstrip("0123456789")].items():
                total[base] = total.get(base, 0) + sign * power * each
    return total


def _number(variable: Variable, value: float) -> str:
    if variable.kind == "boolean":
        return "true" if value else "false"
    return str(round(value)) if variable.kind == "integer" else repr(value)


def _attributes(variable: Variable, place: int) -> dict[str, str]:
    attributes = {"name": variable.name, "valueReference": str(place), "causality": variable.causality}
    variability = variable.variability
    if variable.kind != "real" and variability == "continuous":
        variability = "discrete"
    return {**attributes, "variability": variability, "description": variable.meaning}


def _typed(variable: Variable) -> dict[str, str]:
    """Return what a variable's type says: start, unit and range."""
    attributes: dict[str, str] = {}
    if variable.unit:
        attributes["unit"] = show_unit(variable.unit)
    for name, bound in (("min", variable.minimum), ("max", variable.maximum)):
        if math.isfinite(bound) and variable.variability != "constant":
            attributes[name] = _number(variable, bound)
    if variable.causality != "output":
        attributes["start"] = _number(variable, variable.start)
    return attributes


def _variable_2(parent: Xml.Element, variable: Variable, place: int) -> None:
    element = Xml.SubElement(parent, "ScalarVariable", _attributes(variable, place))
    Xml.SubElement(
        element, {"real": "Real", "integer": "Integer", "boolean": "Boolean"}[variable.kind], _typed(variable)
    )


def _variable_3(parent: Xml.Element, variable: Variable, place: int) -> None:
    kind = {"real": "Float64", "integer": "Int32", "boolean": "Boolean"}[variable.kind]
    Xml.SubElement(parent, kind, {**_attributes(variable, place), **_typed(variable)})


_VARIABLE = {2: _variable_2, 3: _variable_3}


def _structure(root: Xml.Element, unit: Unit, fmi: int) -> None:
    structure = Xml.SubElement(root, "ModelStructure")
    outputs = [place for place, each in enumerate(unit.variables) if each.causality == "output"]
    if fmi == 3:
        for name in ("Output", "InitialUnknown"):
            for place in outputs:
                Xml.SubElement(structure, name, {"valueReference": str(place)})
        return
    for name in ("Outputs", "InitialUnknowns"):
        group = Xml.SubElement(structure, name)
        for place in outputs:
            Xml.SubElement(group, "Unknown", {"index": str(place + 1)})
