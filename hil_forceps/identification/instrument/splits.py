"""Which runs of an instrument are fitted to and which are held out; frequencies and load levels come from the data."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from hil_forceps.identification.instrument.report import RunInfo, SAME_FREQUENCY_Hz

ODD_LOADS, EXTREMES = "odd loads", "highest frequency and load"


class Split(NamedTuple):
    """Names of the runs on either side; of all of them `levels`, 0 the lowest load, and `series`, 0 the slowest."""

    name: str
    train: tuple[str, ...]
    held_out: tuple[str, ...]
    levels: Mapping[str, int]
    series: Mapping[str, int]


def splits(runs: Sequence[RunInfo]) -> tuple[Split, ...]:
    """Return the splits that the runs allow: odd load levels held out; the highest frequency and load held out."""
    frequencies = _frequency_groups(runs)
    levels = load_levels(runs, frequencies)
    top_frequency, top_level = max(frequencies.values(), default=0), max(levels.values(), default=0)
    held = {
        ODD_LOADS: {name for name, level in levels.items() if level % 2},
        EXTREMES: {run.name for run in runs if frequencies[run.name] == top_frequency or levels[run.name] == top_level},
    }
    made = []
    for name, out in held.items():
        train = tuple(run.name for run in runs if run.name not in out)
        if train and out:
            held_out = tuple(run.name for run in runs if run.name in out)
            made.append(Split(name, train, held_out, levels, frequencies))
    return tuple(made)


def load_levels(runs: Sequence[RunInfo], frequencies: Mapping[str, int]) -> dict[str, int]:
    """Number the load levels from the lowest; runs of a level are nearer to each other than half a usual step.

    A usual step is the range of loads over the most runs that any one frequency has.
    """
    if not runs:
        return {}
    ordered = sorted(runs, key=lambda run: run.load_N_m)
    groups = list(frequencies.values())
    most = max(groups.count(group) for group in set(groups))
    step_N_m = (ordered[-1].load_N_m - ordered[0].load_N_m) / max(most - 1, 1)
    levels, level = {}, 0
    for before, run in zip([ordered[0], *ordered], ordered, strict=False):
        level += run.load_N_m - before.load_N_m > 0.5 * step_N_m
        levels[run.name] = level
    return levels


def _frequency_groups(runs: Sequence[RunInfo]) -> dict[str, int]:
    ordered = sorted(runs, key=lambda run: run.frequency_Hz)
    groups, group = {}, 0
    for before, run in zip([*ordered[:1], *ordered], ordered, strict=False):
        group += run.frequency_Hz - before.frequency_Hz >= SAME_FREQUENCY_Hz
        groups[run.name] = group
    return groups
