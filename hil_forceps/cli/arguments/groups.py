"""Headings under which `--help` lists the options of a command."""

from typing import Annotated, Final, TypeVar

from cyclopts import Group, Parameter

T = TypeVar("T")

_LINE: Final = Parameter(group=Group("Line to the drive", sort_key=1))
_CONTROL: Final = Parameter(group=Group("Control", sort_key=2))
_OUTSIDE: Final = Parameter(group=Group("External references", sort_key=6))
_OUTPUT: Final = Parameter(group=Group("Output", sort_key=3))
_LIVE: Final = Parameter(group=Group("Live page", sort_key=5))
_END: Final = Parameter(group=Group("Faults", sort_key=4))

OfLine = Annotated[T, _LINE]
OfControl = Annotated[T, _CONTROL]
OfOutput = Annotated[T, _OUTPUT]
OfOutside = Annotated[T, _OUTSIDE]
OfLive = Annotated[T, _LIVE]
OfFaults = Annotated[T, _END]
