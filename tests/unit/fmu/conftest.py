"""FMUs of this machine's own compiler, made once, and how they are stepped."""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import pytest
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave
from numpy.typing import NDArray

from hil_forceps.fmu.build import write_fmu
from hil_forceps.fmu.estimator_unit import estimator_unit
from hil_forceps.fmu.plant_unit import plant_unit
from hil_forceps.fmu.unit import Unit
from hil_forceps.rig import Rig, load_rig

ROOT = Path(__file__).parents[3]


class Made(NamedTuple):
    """An FMU, and where it is unpacked."""

    file: Path
    folder: Path
    unit: Unit

    @property
    def places(self) -> dict[str, int]:
        return {variable.name: place for place, variable in enumerate(self.unit.variables)}


Make = Callable[[Unit, Literal[2, 3]], Made]


@pytest.fixture(scope="session")
def rig() -> Rig:
    return load_rig(ROOT / "configs" / "paper.yaml")


@pytest.fixture(scope="session")
def make(tmp_path_factory: pytest.TempPathFactory) -> Make:
    def make_(unit: Unit, fmi: Literal[2, 3]) -> Made:
        folder = tmp_path_factory.mktemp("fmu")
        file = folder / "unit.fmu"
        write_fmu(unit, fmi, file, zig=False)
        return Made(file, Path(extract(str(file), str(folder / "unpacked"))), unit)

    return make_


@pytest.fixture(scope="session")
def plant_fmu(make: Make, rig: Rig) -> Made:
    return make(plant_unit(rig, 1e-3), 2)


@pytest.fixture(scope="session")
def kalman_fmu_3(make: Make, rig: Rig) -> Made:
    return make(estimator_unit(rig, "kalman", 1e-3), 3)


class Running:
    """An instance that is stepped; `said` holds what it told of errors."""

    def __init__(self, made: Made, start: Mapping[str, float] | None = None) -> None:
        description = read_model_description(str(made.folder))
        kind = FMU2Slave if description.fmiVersion == "2.0" else FMU3Slave
        self.places, self.unit, self.said = made.places, made.unit, list[str]()
        simulation = description.coSimulation
        self.fmu: Any = kind(
            guid=description.guid, unzipDirectory=str(made.folder), modelIdentifier=simulation.modelIdentifier
        )
        self.version = 2 if kind is FMU2Slave else 3
        self.fmu.instantiate()
        self.set({} if start is None else start)
        if self.version == 2:
            self.fmu.setupExperiment(startTime=0.0)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(startTime=0.0)
        self.set({} if start is None else start)
        self.fmu.exitInitializationMode()
        self.time_s = 0.0

    def set(self, values: Mapping[str, float]) -> None:
        for name, value in values.items():
            kind = self.unit.variables[self.places[name]].kind
            method = {"real": "Real" if self.version == 2 else "Float64", "boolean": "Boolean"}.get(kind)
            method = method or ("Integer" if self.version == 2 else "Int32")
            given = {"real": float, "boolean": bool, "integer": int}[kind](value)
            getattr(self.fmu, f"set{method}")([self.places[name]], [given])

    def get(self, *names: str) -> list[float]:
        read = self.fmu.getReal if self.version == 2 else self.fmu.getFloat64
        values: list[float] = read([self.places[name] for name in names])
        return values

    def step(self, step_s: float) -> None:
        self.fmu.doStep(currentCommunicationPoint=self.time_s, communicationStepSize=step_s)
        self.time_s += step_s

    def run(
        self, step_s: float, inputs: Mapping[str, NDArray[np.float64]], outputs: tuple[str, ...]
    ) -> dict[str, NDArray[np.float64]]:
        """Step along the rows of the inputs; outputs have one row more: at the start."""
        rows = [self.get(*outputs)]
        for row in zip(*inputs.values(), strict=True):
            self.set(dict(zip(inputs, row, strict=True)))
            self.step(step_s)
            rows.append(self.get(*outputs))
        return dict(zip(outputs, np.array(rows).T, strict=True))


Run = Callable[..., Running]


@pytest.fixture
def running() -> Iterator[Run]:
    open_: list[Running] = []

    def start(made: Made, values: Mapping[str, float] | None = None) -> Running:
        open_.append(Running(made, values))
        return open_[-1]

    yield start
    for each in open_:
        each.fmu.freeInstance()
