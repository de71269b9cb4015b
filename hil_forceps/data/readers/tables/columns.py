"""The columns of a table as columns of a run: by their names and units, or by a mapping; never by a guess."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from hil_forceps.data.column_names import left_out, show_name, split_name
from hil_forceps.data.readers.no_run import NoRunError
from hil_forceps.data.readers.tables.mapping import LEFT_OUT, ColumnMap, Source, entry
from hil_forceps.data.readers.tables.proposals import proposed
from hil_forceps.data.readers.tables.units import UNITS, unit_of
from hil_forceps.data.readers.tables.written_name import WrittenName, parse_name
from hil_forceps.data.run import KNOWN_COLUMNS, REQUIRED_COLUMNS, TORQUE_COLUMNS
from hil_forceps.rig.errors import UserError

_KINDS = {  # of units that a column of a run is made from, by its SI unit
    "s": ("s",),
    "rad": ("rad", "count", "rad_per_s"),
    "A": ("A",),
    "V": ("V",),
    "N_m": ("N_m", "rated"),
}
_COUNTED = ("theta_m_rad", "theta_m_ref_rad")  # by the encoder that a rig describes
_INTEGRATED = ("theta_m_rad",)
_SI = {"s": "s", "rad": "rad", "A": "A", "V": "V", "N_m": "Nm"}
_MAX_SHOWN_ERRORS = 20
_MAX_SHOWN_NAMES = 12


class Use(NamedTuple):
    """A column of a run and where it comes from."""

    name: str
    position: int  # among the columns of the file, from 0
    unit: str  # as the file or the mapping writes it, "" where the file's name is the run's


@dataclass(frozen=True, slots=True)
class Header:
    """What a table says of its columns: a name each, and a unit each where a row has them."""

    names: tuple[str, ...]
    units: tuple[str, ...] = ()
    place: str = ""  # of the names, for messages: path and line
    group: str = ""  # a path that all names have in front, for mappings that say it

    def unit(self, position: int) -> str:
        """Return what the row of units says of a column."""
        return self.units[position].strip() if position < len(self.units) else ""


@dataclass(slots=True)
class Found:
    """What came of a header."""

    uses: list[Use] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    proposals: list[tuple[str, str, str]] = field(default_factory=list)  # column of a run, of the file, unit

    @property
    def names(self) -> set[str]:
        """Return the columns of a run that are there."""
        return {use.name for use in self.uses}


OnColumns = Callable[[Header, Found], object]  # is told what came of each header


def choose_columns(header: Header, mapping: ColumnMap) -> Found:
    """Find the columns of a run; `errors` says what has to be typed where that can't be done without a guess."""
    found = Found()
    parsed = [parse_name(name) for name in header.names]
    mapped = 0
    for name in KNOWN_COLUMNS:
        before = len(found.errors)
        if name in mapping:
            _by_mapping(name, mapping[name], header, found)
            mapped += len(found.errors) == before
        elif header.names.count(name) > 1:
            found.errors.append(f"column {show_name(name)} is there twice")
        elif name in header.names:
            _by_name(name, header.names.index(name), header, found)
        else:
            _by_quantity(name, parsed, header, found)
    used = {use.position for use in found.uses}
    found.notes += [
        left_out(each) for at, each in enumerate(header.names) if at not in used and each and each not in KNOWN_COLUMNS
    ]
    if not found.errors or not (mapped or found.uses):
        _look_for_missing(header, found, mapping)
    return found


def require_columns(found: Found, header: Header, *, mapped: bool) -> None:
    """UserError with everything that is wrong; NoRunError where the table has nothing of a run."""
    if not found.errors:
        return
    told = [f"{header.place}: {error}" for error in found.errors[:_MAX_SHOWN_ERRORS]]
    if found.uses or any(column in header.names for column in KNOWN_COLUMNS):
        raise UserError(told)
    if mapped:
        raise NoRunError(told)
    first = f"{header.place}: none of the columns of a run ({', '.join(KNOWN_COLUMNS)}) is in it"
    lines = " ".join(
        entry(name, column, unit or split_name(name)[1]) for name, column, unit in found.proposals
    ) or entry("time_s", "COLUMN", "UNIT")
    raise NoRunError(f"{first}; if it has them by other names, add {lines}")


def _by_name(name: str, position: int, header: Header, found: Found) -> None:
    row = header.unit(position)
    unit = unit_of(row)
    own = unit_of(split_name(name)[1])
    if unit is not None and unit != own:
        which = " or ".join(entry(name, name, each) for each in (split_name(name)[1], row))
        found.errors.append(f"column {name} has the unit {row!r} in the row of units; say which holds: {which}")
    else:
        found.uses.append(Use(name, position, ""))


def _by_quantity(name: str, parsed: Sequence[WrittenName], header: Header, found: Found) -> None:
    """Take a column that names the quantity, if in one place only and with a unit of its kind."""
    units = {
        at: each.unit or header.unit(at)
        for at, each in enumerate(parsed)
        if each.column == name and _can_be(name, each.unit or header.unit(at), is_told=False)
    }
    if len(units) > 1:
        which = " or ".join(entry(name, header.names[at], "") for at in list(units)[:3])
        found.errors.append(f"{len(units)} columns say {split_name(name)[0]} with a unit; say which: {which}")
    for position, unit in list(units.items())[:1] if len(units) == 1 else ():
        row = header.unit(position)
        other = parsed[position].other_unit or (row if unit_of(row) not in (None, unit_of(unit)) else "")
        if other:
            which = " or ".join(entry(name, header.names[position], each) for each in (unit, other))
            found.errors.append(f"column {show_name(header.names[position])} has two units; say which holds: {which}")
        else:
            _use(name, position, unit, header, found)


def _by_mapping(name: str, source: Source, header: Header, found: Found) -> None:
    if source.text == LEFT_OUT:
        found.notes.append(f"column {name} was left out, as {source.told_by} says")
        return
    position, unit = _place(source, header)
    if position is None:
        found.errors.append(f"{source.told_by}: {_no_place(name, source, header)}")
        return
    row = header.unit(position)
    written = parse_name(header.names[position]).unit or (row if unit_of(row) else "")
    if unit and unit_of(written) not in (None, unit_of(unit)):
        found.notes.append(f"{name}: {source.told_by} says {unit} where the file says {written}")
    unit = unit or written
    if _can_be(name, unit or split_name(name)[1], is_told=True):
        _use(name, position, unit, header, found)
        return
    kinds = _KINDS[split_name(name)[1]]
    possible = ", ".join(each for each, known in UNITS.items() if known.kind in kinds)
    told = f"column {show_name(header.names[position])} is in {unit}; {name} is made from {possible}"
    found.errors.append(f"{source.told_by}: {told}")


def _no_place(name: str, source: Source, header: Header) -> str:
    column, _, end = source.text.rpartition(":")
    count = header.names.count(column) or header.names.count(source.text)
    if count > 1:
        return f"{count} columns have that name; give the place of one, as #2:{end or 'UNIT'}"
    if column in header.names:
        return f"{end!r} is no unit that is read ({', '.join(UNITS)})"
    near = proposed(name, header.names, header.units)
    guess = f"; meant {near[0]!r}?" if near else ";"
    shown = ", ".join(map(show_name, header.names[:_MAX_SHOWN_NAMES]))
    return f"the file has no column {show_name(source.text)}{guess} it has {shown}"


def _place(source: Source, header: Header) -> tuple[int | None, str]:
    """Find (position, unit) that a mapping means: the whole text as a name, else what is before the last colon."""
    before, _, unit = source.text.rpartition(":")
    for written, its_unit in ((source.text, ""), (before, unit) if unit_of(unit) else ("", "")):
        column = (
            written.removeprefix("/").removeprefix(f"{header.group}/") if header.group else written.removeprefix("/")
        )
        column = written if written in header.names else column
        matches = [at for at, name in enumerate(header.names) if name == column]
        if not matches:
            matches = [at for at, name in enumerate(header.names) if name.strip().lower() == column.strip().lower()]
        if not matches:
            matches = [at for at, name in enumerate(header.names) if parse_name(name).base == column.strip().lower()]
        if len(matches) == 1 and column:
            return matches[0], its_unit
        number = column[1:] if column.startswith("#") and column[1:].isascii() else ""
        if number.isdigit() and len(number) < 6 and 1 <= int(number) <= len(header.names):
            return int(number) - 1, its_unit
    return None, ""


def _can_be(name: str, text: str, *, is_told: bool) -> bool:
    """Tell whether a column of a run is made from that unit: speeds if so told, counts by the motor's encoder."""
    unit = unit_of(text)
    if unit is None or unit.kind not in _KINDS[split_name(name)[1]]:
        return False
    if unit.kind == "rad_per_s":
        return is_told and name in _INTEGRATED
    return unit.kind != "count" or name in _COUNTED


def _use(name: str, position: int, text: str, header: Header, found: Found) -> None:
    wanted = split_name(name)[1]
    unit = UNITS[_SI[wanted]] if not text else unit_of(text)
    found.uses.append(Use(name, position, text))
    how = f"from {text}"
    if unit is not None and unit.kind == wanted:
        how = f"in {wanted.replace('_', ' ')}" if unit.factor == 1.0 else f"from {text}, times {unit.factor:.12g}"
    found.notes.append(f"column {show_name(header.names[position])} was read as {name}, {how}")


def _look_for_missing(header: Header, found: Found, mapping: ColumnMap) -> None:
    wanted = [name for name in REQUIRED_COLUMNS if name not in found.names and name not in mapping]
    found.errors += [f"column {name} is missing{_hint(name, header, found)}" for name in wanted]
    if any(name in found.names for name in TORQUE_COLUMNS):
        return
    current, torque = TORQUE_COLUMNS
    has_current = proposed(current, header.names, header.units) is not None
    which = torque if not has_current and proposed(torque, header.names, header.units) else current
    found.errors.append(f"neither {current} nor {torque} is there{_hint(which, header, found)}")


def _hint(wanted: str, header: Header, found: Found) -> str:
    near = proposed(wanted, header.names, header.units)
    if near is None or any(near[0] == column for _, column, _ in found.proposals):
        return f"; name the column that holds it: {entry(wanted, 'COLUMN', 'UNIT')}"
    column, unit = near
    found.proposals.append((wanted, column, unit))
    if unit:
        return f"; if {show_name(column)} is it, add {entry(wanted, column, '')}"
    return (
        f"; if {show_name(column)} is it, in SI, name it {wanted}, "
        f"or add {entry(wanted, column, split_name(wanted)[1])} with its unit behind the colon"
    )
