"""Drives that break one requirement each: the Python drive with one thing changed, and what must then fail.

A mutation takes a device that is whole and breaks it in place. Where no drive can break one requirement alone, the
row names all that fall together, and why.
"""

from collections.abc import Callable
from types import MethodType
from typing import Any, NamedTuple

from firmware_protocol import codec
from firmware_protocol.drive.machine import DriveMachine
from firmware_protocol.frames import Frame, split_id
from firmware_protocol.messages import (
    Control,
    Function,
)
from firmware_protocol.parameters import BY_INDEX
from firmware_protocol.states import DriveEvent
from tests.conformance.devices import NODE, Device

Break = Callable[[Device], None]
Frames = list[Frame]
Handler = Callable[..., Frames]  # what a mutation wraps
ENABLE, RESET = Control.ENABLE, Control.FAULT_RESET


class Broken(NamedTuple):
    """A broken drive: how it is broken, what must fail, and on which line it is found."""

    name: str
    fails: frozenset[int]
    line: str  # can, fd, serial or udp
    mutate: Break


BROKEN: list[Broken] = []


def breaks(*fails: int, line: str = "can") -> Callable[[Break], Break]:
    """Enter a mutation into the table."""

    def enter(mutate: Break) -> Break:
        BROKEN.append(Broken(mutate.__name__, frozenset(fails), line, mutate))
        return mutate

    return enter


def wrap(owner: Any, name: str, around: Callable[..., Any]) -> None:
    """Replace a method by `around(old, ...)`; the drive's table of handlers is renewed."""
    old = getattr(owner, name)
    setattr(owner, name, lambda *arguments: around(old, *arguments))
    if isinstance(owner, DriveMachine):
        owner._take_node(owner.node)


def on_sent(d: Device, change: Callable[[Frame], Frames]) -> None:
    """Change what the drive sends, frame by frame."""
    for name in ("receive", "poll", "sample"):
        wrap(d, name, lambda old, *a: [new for frame in old(*a) for new in change(frame)])


def resend(function: Function, change: Callable[[Any], Any]) -> Callable[[Frame], Frames]:
    """Return a change of one message's fields, sealed anew."""
    decoder = codec.Decoder()

    def of(frame: Frame) -> Frames:
        if split_id(frame.arbitration_id)[0] != function:
            return [frame]
        return [codec.encode(change(decoder.decode(frame)))]

    return of


def host_frame(frame: Frame, function: Function) -> bool:
    return split_id(frame.arbitration_id) == (function, NODE)


def has_known_index(frame: Frame) -> bool:
    """Tell a request from garbage, which may be right by chance where half of the rules are missing."""
    return len(frame.data) == 8 and int.from_bytes(frame.data[1:3], "little") in BY_INDEX


def executes(d: Device, change: Callable[..., Any]) -> None:
    """Execute requests otherwise: `change(old, store, op, index, value, disabled)`."""
    store = d.machine._values
    old = store.execute
    new = MethodType(lambda _self, *a: change(old, store, *a), store)
    store.execute = new  # type: ignore[method-assign]


def judges(d: Device, change: Callable[[DriveEvent, int, int, int], DriveEvent]) -> None:
    """Judge references otherwise: `change` gets the right event, reference, advance, angle."""

    def judge(old: Any, reference: int, advance: int, theta: int) -> DriveEvent:
        return change(old(reference, advance, theta), reference, advance, theta)

    wrap(d.machine, "_judge_reference", judge)
