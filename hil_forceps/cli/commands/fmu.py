"""`hil-forceps fmu`: plant and estimators for Simulink, Dymola, OpenModelica and others."""

import sys
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter, validators

from hil_forceps.cli.arguments.files import make_folder
from hil_forceps.cli.terminal.notes import note
from hil_forceps.estimation.registry import effects_passed_over
from hil_forceps.fmu.build import PlatformName, write_fmu
from hil_forceps.fmu.estimator_unit import estimator_unit
from hil_forceps.fmu.plant_unit import LEFT_OUT, plant_unit
from hil_forceps.fmu.unit import Unit
from hil_forceps.rig import Rig, load_rig
from hil_forceps.rig.errors import UserError
from hil_forceps.rig.schema import AlgorithmId


def fmu(
    *,
    rig: Path,
    unit: Literal["plant", "estimator"],
    out: Path,
    algorithm: AlgorithmId = "kalman",
    fmi: Literal[2, 3] = 2,
    sample_time: Annotated[float | None, Parameter(validator=validators.Number(gt=0.0))] = None,
    platform: tuple[PlatformName, ...] = ("x86_64-linux",),
) -> int:
    """Write the plant with its effects, or an estimator, as a functional mock-up unit (FMU) for co-simulation.

    The FMU contains compiled C code and its sources; it needs no Python. It computes the same as `simulate` and the
    service. docs/matlab.md describes its variables, and how to open it in Simulink.

    Parameters
    ----------
    rig
        Rig file; its values are the start values of the unit's parameters.
    unit
        plant: motor, wire, jaw, sensors and the drive's position loop. estimator: the estimator of the service.
    out
        File to write; must end in .fmu.
    algorithm
        Algorithm of the estimator.
    fmi
        Version of the FMI standard: 2 (read by most programs) or 3.
    sample_time
        Seconds between the drive's samples; default: that of the rig, or 1 ms if the rig has no drive.
    platform
        Platform to compile for; may be repeated. The first time for a platform takes minutes, because its C library is
        compiled, too.
    """
    if out.suffix != ".fmu":
        raise UserError(f"--out {out}: must end in .fmu; rename it")
    known = load_rig(rig)
    made = plant_unit(known, sample_time) if unit == "plant" else estimator_unit(known, algorithm, sample_time)
    _tell_what_is_left_out(known, unit, algorithm)
    make_folder(out.parent)
    write_fmu(made, fmi, out, platform)
    sys.stdout.write(_summary(made, fmi, out, platform))
    return 0


def _tell_what_is_left_out(rig: Rig, unit: str, algorithm: AlgorithmId) -> None:
    if unit == "estimator":
        for effect in effects_passed_over(algorithm, rig):
            note(f"effects.{effect}: not modelled by the estimator {algorithm}; left out of the FMU")
        return
    if LEFT_OUT in rig.effects:
        note(
            f"effects.{LEFT_OUT}: delays channels of a recording only, left out of the FMU; delay the outputs in your "
            "log"
        )
    if any((rig.noise.current_A, rig.noise.theta_j_rad, rig.noise.tau_w_N_m)):
        note("noise: left out of the FMU; add it to the outputs")


def _summary(unit: Unit, fmi: int, out: Path, platforms: tuple[str, ...]) -> str:
    counts = {way: sum(each.causality == way for each in unit.variables) for way in ("input", "output", "parameter")}
    shown = ", ".join(f"{count} {way}s" for way, count in counts.items() if count)
    step = "a multiple of" if unit.sample_time_place >= 0 else "best"
    return (
        f"{out}: {unit.name}, FMI {fmi}.0 co-simulation; {shown}\n"
        f"communication step: {step} {unit.sample_time_s:g} s; runs on: {', '.join(platforms)}\n"
    )
