"""Columns that may be meant by names which aren't a run's: to be told with the line to type, never to be taken."""

import difflib
from collections.abc import Sequence

from hil_forceps.data.column_names import split_name
from hil_forceps.data.readers.tables.units import unit_of
from hil_forceps.data.readers.tables.written_name import parse_name
from hil_forceps.data.run import KNOWN_COLUMNS

# What the field, drives' tools and loggers call them.
_OTHER_NAMES = {
    "time_s": ("time", "t", "timestamp", "time_stamp", "zeit", "x_value", "__time", "x_axis"),
    "theta_m_ref_rad": ("position_demand_value", "setpoint", "reference", "target_position", "pos_ref", "sollwert"),
    "theta_m_rad": (
        *("position", "pos", "angle", "theta", "q", "qm", "encoder", "winkel", "position_actual_value"),
        *("motor_position", "motor_angle", "pos_estimate", "angle_m", "istposition"),
    ),
    "theta_drive_rad": ("drive_position", "motor_encoder"),
    "current_A": ("current", "cur", "i", "iq", "i_q", "motor_current", "current_actual_value", "iq_measured", "strom"),
    "voltage_V": ("voltage", "u", "motor_voltage", "spannung"),
    "theta_j_rad": ("jaw_angle", "jaw", "jaw_position", "theta_jaw"),
    "tau_w_N_m": ("load", "jaw_torque", "load_torque", "reaction_torque"),
    "tau_m_N_m": ("torque", "tau", "motor_torque", "torque_actual_value", "drehmoment", "moment"),
}
_MIN_SIMILARITY_RATIO = 0.6  # of difflib's ratio: its own default
_COMPARED_CHARACTERS = 40
_MAX_COMPARED_NAMES = 200


def proposed(wanted: str, names: Sequence[str], units: Sequence[str]) -> tuple[str, str] | None:
    """Return (column of the file, its unit where that is written) that may be `wanted`; None where none is like it."""
    foreign = [(at, name) for at, name in enumerate(names[:_MAX_COMPARED_NAMES]) if name and name not in KNOWN_COLUMNS]
    quantity = split_name(wanted)[0]
    scored = [(_likeness(name, quantity, wanted), -at, name) for at, name in foreign]
    best = max(scored, default=(0.0, 0, ""))
    if best[0] < _MIN_SIMILARITY_RATIO:
        return None
    row = units[-best[1]] if -best[1] < len(units) else ""
    unit = parse_name(best[2]).unit or (row if unit_of(row) else "")
    return best[2], unit.strip()


def _likeness(name: str, quantity: str, wanted: str) -> float:
    parsed = parse_name(name[: 4 * _COMPARED_CHARACTERS])
    if parsed.column:
        return 1.0 if parsed.column == wanted else 0.0
    base = parsed.base.rsplit("/", 1)[-1]
    others = _OTHER_NAMES[wanted]
    if base in others or base == quantity:
        return 1.0
    words = base.split("_")
    if any(other in words for other in others if len(other) > 2):
        return 0.9
    spelled = difflib.SequenceMatcher(None, wanted, base[:_COMPARED_CHARACTERS]).ratio()
    return 0.8 * spelled if len(base) > 2 and spelled >= _MIN_SIMILARITY_RATIO + 0.15 else 0.0
