"""Checks of the arguments of the API before any work begins; each error names the argument and the remedy.

TypeError for a wrong type, ValueError for a wrong value.
"""

import math
from collections.abc import Sequence
from numbers import Integral, Real
from typing import Any

from hil_forceps.control.trajectories import Trajectory
from hil_forceps.rig.errors import UserError


def kind(value: object) -> str:
    """Return the type of a value in words, with an article."""
    name = "None" if value is None else type(value).__name__
    return name if value is None else f"an {name}" if name[0].lower() in "aeiou" else f"a {name}"


def check_number(name: str, value: object, unit: str, *, is_positive: bool = False) -> None:
    """Refuse values that are not finite numbers, or not above 0 if that is required."""
    if isinstance(value, bool) or not isinstance(value, Real):
        raise TypeError(f"{name}: must be a number ({unit}), not {kind(value)}")
    if not math.isfinite(value) or (is_positive and not float(value) > 0.0):
        raise ValueError(f"{name}: is {value!r}; must be a finite number{' above 0' if is_positive else ''} ({unit})")


def check_whole(name: str, value: object, least: int | None = 0) -> None:
    """Refuse values that are not integers, or below a minimum."""
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise TypeError(f"{name}: must be a whole number, not {kind(value)}")
    if least is not None and int(value) < least:
        raise ValueError(f"{name}: is {value}; must be {least} or more")


def check_duration(name: str, value: object) -> None:
    """Refuse durations that are not positive; None, the default, passes."""
    if value is not None:
        check_number(name, value, "s", is_positive=True)


def check_sample(name: str, value: object) -> None:
    """Refuse values that are not finite numbers; UserError if not finite, because samples are measured."""
    if not isinstance(value, Real):
        raise TypeError(f"{name}: must be a number, not {kind(value)}; `estimate` takes a whole record")
    if not math.isfinite(value):
        raise UserError(f"{name}: is {value}, not a finite number; leave this sample out, gaps are allowed")


def check_stamp(name: str, value: object) -> None:
    """Refuse values that are not an integer number of nanoseconds."""
    if not isinstance(value, Integral):
        raise TypeError(f"{name}: must be whole nanoseconds, not {kind(value)}; of seconds: round(1e9 * t)")


def check_text(name: str, value: object) -> None:
    """Refuse values that are not texts."""
    if not isinstance(value, str):
        raise TypeError(f"{name}: must be a text, not {kind(value)}")


def check_texts(name: str, value: object) -> None:
    """Refuse values that are not sequences of texts; a single text would be iterated by letters."""
    if isinstance(value, str):
        raise TypeError(f"{name}: must be a list of texts, not one; write [{value!r}]")
    if not isinstance(value, Sequence):
        raise TypeError(f"{name}: must be a list of texts, not {kind(value)}")
    for each in value:
        if not isinstance(each, str):
            raise TypeError(f"{name}: must be a list of texts, and one of these is {kind(each)}")


def check_motion(name: str, value: object) -> None:
    """Refuse values that are not trajectories, and trajectories that begin before time 0."""
    if not isinstance(value, Trajectory):
        raise TypeError(f"{name}: must be a Trajectory, not {kind(value)}; write hf.Trajectory(times_s, angles_rad)")
    if value.times_s[0] < 0.0:
        raise ValueError(
            f"{name}: begins at {value.times_s[0]:g} s, but its time counts from the first sample in operation; "
            "let it begin at 0 or later"
        )


def load_trajectory(name: str, load: Any) -> Trajectory:
    """Return a load as a trajectory of torques [N m]; a number is a constant load."""
    if isinstance(load, Trajectory):
        return load
    if not isinstance(load, Real):
        raise TypeError(f"{name}: must be a number (N m) or a Trajectory of torques, not {kind(load)}")
    check_number(name, load, "N m")
    return Trajectory((0.0,), (float(load),))
