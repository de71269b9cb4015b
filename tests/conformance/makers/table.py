"""Makers' drives that break promises: a simulated drive, or the machine in front of it, with one thing changed.

A mutation breaks a drive in place. Where no drive can break one promise alone, the row names all that fall together.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from hil_forceps.rig import Rig

Break = Callable[["Broken"], None]
Reference = int | None
Sampled = tuple[int, int, int, int]  # θ_m, current, θ_j, τ_w; raw


class Broken:
    """A drive under the knife: `peer` on the bus, `machine` of the host."""

    def __init__(self, rig: Rig, peer: Any, machine: Any) -> None:
        self.rig, self.peer, self.machine = rig, peer, machine


class Row(NamedTuple):
    """How a drive is broken, with which profile, what must fail, and what of the rig is changed for it."""

    name: str
    profile: str
    fails: frozenset[int]
    mutate: Break
    limits: dict[str, float]


ROWS: list[Row] = []


def breaks(*fails: int, profiles: tuple[str, ...] = ("odrive",), **limits: float) -> Callable[[Break], Break]:
    """Enter a mutation into the table, once for each profile."""

    def enter(mutate: Break) -> Break:
        ROWS.extend(Row(mutate.__name__, profile, frozenset(fails), mutate, limits) for profile in profiles)
        return mutate

    return enter


def wrap(owner: Any, name: str, around: Callable[..., Any]) -> None:
    """Replace a method by `around(old, ...)`."""
    old = getattr(owner, name)
    setattr(owner, name, lambda *arguments: around(old, *arguments))


def leads(b: Broken, change: Callable[[int, int, int], int]) -> None:
    """Lead the motor elsewhere: `change(reference, angle at which torque began, ns since then)` is followed."""
    began: list[int] = []  # ns, raw
    newest = [0]

    def sample(old: Callable[..., Sampled], now_ns: int, until_ns: int, reference: Reference) -> Sampled:
        if reference is None:
            began.clear()
        else:
            began[:] = began or [now_ns, newest[0]]
            reference = change(reference, began[1], now_ns - began[0])
        sampled = old(now_ns, until_ns, reference)
        newest[0] = sampled[0]
        return sampled

    newest[0] = b.peer._forceps.read(0).theta_m
    wrap(b.peer._forceps, "sample", sample)


def measures(b: Broken, change: Callable[[int, int, bool], tuple[int, int]]) -> None:
    """Measure something else: `change(angle, current, has torque)`."""

    def sample(old: Callable[..., Sampled], now_ns: int, until_ns: int, reference: Reference) -> Sampled:
        theta, current, *others = old(now_ns, until_ns, reference)
        return *change(theta, current, reference is not None), others[0], others[1]

    wrap(b.peer._forceps, "sample", sample)
