"""What a unit is: its variables, its memory and its kernels, which say what happens at each communication step."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

Causality = Literal["parameter", "input", "output", "local"]
Variability = Literal["constant", "fixed", "tunable", "continuous", "discrete"]
# The variables' values and the unit's memory, both changed in place, and the time of the step's start; 0, or which of
# the unit's `problems` it is. `begin` and `prepare` have no use for the time.
Kernel = Callable[[Vector, Vector, int], int]


@dataclass(frozen=True, slots=True)
class Variable:
    """A variable of a unit; its place among them is its value reference."""

    name: str
    unit: str  # as rig files write them; "" for a pure number
    causality: Causality
    variability: Variability
    start: float
    meaning: str
    kind: Literal["real", "integer", "boolean"] = "real"
    minimum: float = -math.inf
    maximum: float = math.inf


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit for one rig."""

    name: str  # of the model, an identifier of C
    description: str
    variables: tuple[Variable, ...]
    memory_size: int
    begin: Kernel  # at the end of the initialisation
    prepare: Kernel  # when parameters have changed since
    advance: Kernel  # over one sample
    problems: tuple[str, ...]  # what a kernel's answer means, from 1 on
    sample_time_s: float
    sample_time_place: int  # of the variable that says how long a sample is; -1: a sample is a communication step

    def values(self) -> Vector:
        """Return the values that the variables start with."""
        return np.array([variable.start for variable in self.variables])
