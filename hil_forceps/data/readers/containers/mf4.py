"""MDF (.mf4, .mdf, .dat) through asammdf: channels by name, each group with a time base of its own."""

import importlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hil_forceps.data.readers.containers.content import MAX_NAMES, MAX_SAMPLES, Array, ContentError, Table

TIME = "time_s"  # the time bases, which the format gives in seconds

_Place = tuple[int, int]  # group, channel


def tables(path: Path) -> list[Table]:
    """Return the one table of a file: a column for each numeric channel, and `time_s`."""
    asammdf: Any = importlib.import_module("asammdf")
    file = asammdf.MDF(path)
    names, units, places = [TIME], ["s"], [(-1, -1)]
    for group, content in enumerate(file.groups):
        for channel, each in enumerate(content.channels):
            if channel != file.masters_db.get(group):
                names.append(str(each.name))
                units.append(str(getattr(each, "unit", "") or ""))
                places.append((group, channel))
    if not 2 <= len(names) <= MAX_NAMES:
        raise ContentError(f"{len(names) - 1} channels; a run needs at least 2, and at most {MAX_NAMES} are read")
    names = [
        name if names.count(name) == 1 else f"{place[0]}/{name}" for name, place in zip(names, places, strict=True)
    ]

    def get(positions: Sequence[int], base: int | None) -> list[Array]:
        return _columns(file, names, places, positions, base)

    return [Table("", tuple(names), tuple(units), get)]


def _columns(
    file: Any, names: Sequence[str], places: Sequence[_Place], positions: Sequence[int], base: int | None
) -> list[Array]:
    signals = {at: _signal(file, names[at], places[at]) for at in {*positions, base or 0} if at != 0}
    if base is None:
        times = [signals[at][0] for at in positions if at]
        others = [at for at in positions if at and not np.array_equal(signals[at][0], times[0])]
        if others:
            first = next(at for at in positions if at)
            told = f"{names[first]!r} and {names[others[0]]!r} have different time bases"
            raise ContentError(f"{told}; to interpolate the others at the times of one: --map time_s=@{names[first]}")
        return [times[0] if at == 0 else signals[at][1] for at in positions]
    stamps = signals[base][0]
    inside = np.ones(len(stamps), dtype=bool)
    for time_s, _ in signals.values():  # nothing is extrapolated
        inside &= (stamps >= time_s[0]) & (stamps <= time_s[-1])
    stamps = stamps[inside]
    return [stamps if at == 0 else np.interp(stamps, *signals[at]) for at in positions]


def _signal(file: Any, name: str, place: _Place) -> tuple[Array, Array]:
    group, channel = place
    count = int(file.groups[group].channel_group.cycles_nr)
    if not 2 <= count <= MAX_SAMPLES:
        raise ContentError(f"channel {name!r}: {count} samples")
    signal = file.get(group=group, index=channel)
    values = np.asarray(signal.samples)
    if values.dtype.kind not in "fiu" or values.ndim != 1:
        raise ContentError(f"channel {name!r} contains {values.dtype}, not numbers")
    values = values.astype(np.float64)
    if signal.invalidation_bits is not None:
        values[np.asarray(signal.invalidation_bits, dtype=bool)] = np.nan
    return np.asarray(signal.timestamps, dtype=np.float64), values
