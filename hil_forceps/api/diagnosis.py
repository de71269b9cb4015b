"""`diagnose`: differences between a rig's simulation and measured runs, their causes, and an extended rig."""

import os
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

from hil_forceps.api.arguments import check_number, check_texts, check_whole
from hil_forceps.api.runs import RigSource, Source, as_rig, read_runs
from hil_forceps.api.threads import over_threads
from hil_forceps.control.trajectories import Trajectory
from hil_forceps.data.run import Run
from hil_forceps.diagnosis.options import Options, split_runs
from hil_forceps.diagnosis.result import Diagnosis, Gain, NamedEffect, Verdict, to_json
from hil_forceps.report.diagnosis.cell import cell
from hil_forceps.report.diagnosis.files import write_report
from hil_forceps.report.diagnosis.text import text_lines
from hil_forceps.rig import Rig
from hil_forceps.rig.catalogue import EFFECT_IDS
from hil_forceps.rig.errors import UserError


class FittedParameter(NamedTuple):
    """A fitted value with its 95 % interval."""

    name: str  # dotted, as a rig file has it: `effects.cogging.sine_N_m`, `motor.motor_inertia_kg_m2`
    value: float
    low: float
    high: float
    unit: str
    assumed: float | None  # value in the rig file; None for an effect or an unknown value


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class DiagnosisResult:
    """The result of a diagnosis; printed as on the command line, in a notebook as a table."""

    diagnosis: Diagnosis  # everything, as plain data
    extended_rig: Rig  # the rig with the effects that were found; unchanged if there are none
    next_trajectory: Trajectory | None  # of the jaw, for an experiment that would give more information

    @property
    def verdict(self) -> Verdict:
        """`consistent`, `parameters`, `effects`, `unnamed` or `undetermined`."""
        return self.diagnosis.verdict

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        return self.diagnosis.sentence

    @property
    def causes(self) -> tuple[NamedEffect, ...]:
        """The effects that were found: `id`, `location`, `confidence` (0 to 1), `parameters`."""
        return self.diagnosis.effects

    @property
    def parameters(self) -> tuple[FittedParameter, ...]:
        """All fitted values: parameters of the effects, and known parameters that differ from the rig."""
        of_effects = [
            FittedParameter(f"effects.{effect.id}.{name}", p.value, p.low, p.high, p.unit, None)
            for effect in self.diagnosis.effects
            for name, p in effect.parameters.items()
        ]
        shifts = self.diagnosis.parameter_shifts.items()
        shifted = [
            FittedParameter(name, s.fitted.value, s.fitted.low, s.fitted.high, s.fitted.unit, s.assumed)
            for name, s in shifts
        ]
        return (*of_effects, *shifted)

    @property
    def gain(self) -> Mapping[str, Gain]:
        """Improvement by the extended rig on the runs held out, for each channel."""
        return self.diagnosis.gain

    def to_json(self) -> dict[str, Any]:
        """Return the content of diagnosis.json."""
        return to_json(self.diagnosis)

    def report(self, path: str | PathLike[str]) -> None:
        """Write the report, one HTML page that opens offline; OSError if writing fails."""
        write_report(self.diagnosis, Path(path))

    def __str__(self) -> str:
        return "\n".join(text_lines(self.diagnosis))

    def __repr__(self) -> str:
        return f"<DiagnosisResult {self.verdict}: {', '.join(effect.id for effect in self.causes) or self.sentence}>"

    def _repr_html_(self) -> str:
        return cell(self.diagnosis)


class Wishes(NamedTuple):
    """Options of a diagnosis, as the user gives them."""

    hold_out: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    seed: int = 0
    jobs: int | None = None
    budget_s: float | None = None

    def check(self) -> None:
        """UserError, beginning with the parameter's name, for invalid options."""
        if unknown := [name for name in self.without if name not in EFFECT_IDS]:
            raise UserError(f"without {unknown[0]}: is not an effect of the catalogue; docs/rig-file.md lists all")
        if self.jobs is not None and self.jobs < 1:
            raise UserError(f"jobs {self.jobs}: must be 1 or more")
        if self.seed < 0:
            raise UserError(f"seed {self.seed}: must be 0 or more")
        if self.budget_s is not None and not self.budget_s > 0.0:
            raise UserError(f"budget_s {self.budget_s}: must be more than 0 seconds")

    def check_names(self, runs: Sequence[Run]) -> None:
        """UserError if a run to hold out does not exist, or if no run is left to fit."""
        split_runs(runs, self.hold_out)

    @property
    def threads(self) -> int:
        """Number of threads."""
        return self.jobs or os.cpu_count() or 1


def diagnose(
    runs: Source | Sequence[Source],
    rig: RigSource,
    *,
    hold_out: Sequence[str] = (),
    without: Sequence[str] = (),
    seed: int = 0,
    jobs: int | None = None,
    budget_s: float | None = None,
    progress: Callable[[str], None] | None = None,
) -> DiagnosisResult:
    """Compare the simulation of a rig with measured runs, and find the effects that explain the difference.

    `runs`: one or several sources of `read_runs`. `hold_out`: names of runs held out from fitting and selection; the
    last third by default. `without`: effects of the catalogue to exclude. `seed`: of bootstraps; the same one gives the
    same numbers. `jobs`: number of threads, by default all processors. `budget_s`: time after which no further step
    begins; the result is the best so far and lists what was not tested. `progress`: called with the name of each step.
    UserError for unusable data; data without information give the verdict `undetermined` with its reasons.
    """
    began = time.monotonic()
    check_texts("hold_out", hold_out)
    check_texts("without", without)
    check_whole("seed", seed, least=None)  # its range is checked by `Wishes.check`
    if jobs is not None:
        check_whole("jobs", jobs, least=None)
    if budget_s is not None:
        check_number("budget_s", budget_s, "s")
    wishes = Wishes(tuple(hold_out), tuple(without), seed, jobs, budget_s)
    wishes.check()
    known = as_rig(rig)
    sources = runs if isinstance(runs, list | tuple) else [runs]
    read = read_runs(*sources, rig=known)
    wishes.check_names(read)
    return conclude(read, known, wishes, began, progress or _say_nothing, _say_nothing)


def conclude(
    runs: Sequence[Run],
    rig: Rig,
    wishes: Wishes,
    began_s: float,
    progress: Callable[[str], None],
    to_draw: Callable[[Diagnosis], None],
) -> DiagnosisResult:
    """Diagnose runs that have been read; `began_s`: monotonic time of the budget's start. `to_draw`: see `Options`."""
    # Imported here because it takes a second to load, and other names of this module do not need it.
    from hil_forceps.diagnosis.conclude import diagnose as diagnose_runs  # noqa: PLC0415
    from hil_forceps.diagnosis.validation.conclusion import even_runs  # noqa: PLC0415

    def spent() -> bool:
        return wishes.budget_s is not None and time.monotonic() > began_s + wishes.budget_s

    if wishes.budget_s is not None and even_runs(runs, rig) is None:
        raise UserError("budget_s: only for runs of a drive with known law and references; leave it out for these runs")
    with ThreadPoolExecutor(wishes.threads) as pool:
        mapper = over_threads(pool, wishes.threads)
        without = frozenset(wishes.without)
        options = Options(without, wishes.hold_out, wishes.seed, mapper, progress, to_draw, spent)
        return DiagnosisResult(*diagnose_runs(runs, rig, options))


def _say_nothing(_: object) -> None:
    """Say nothing."""
