"""`hil-forceps replay`: recordings, and measured runs of real instruments, through the estimators."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from hil_forceps.bench.run_folder import RECORDING_NAME
from hil_forceps.cli.commands.runs.replay_recording import replay_recording
from hil_forceps.data.readers.tables.mapping import read_map
from hil_forceps.data.recording.format import FAULT_NAME
from hil_forceps.rig.errors import UserError

RECORDING_SUFFIX = ".mcap"
RIG_SUFFIXES = {".yaml", ".yml"}


def replay(
    source: Path,
    *others: Path,
    rig: Path | None = None,
    out: Path | None = None,
    algorithm: str | None = None,
    black_boxes: bool = False,
    map_: Annotated[tuple[str, ...], Parameter(name="--map", negative="")] = (),
    as_json: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> int:
    """Send what was recorded through the estimators again.

    A recording of ours (.mcap): the same samples must give the same references, byte for byte; exit code 1 and the
    first difference when they don't, and where a part of the recording is damaged or missing.

    Runs of a real instrument (folder or zip of the surgical-tool format, or CSV): jaw torque and jaw angle estimated
    from the motor side, against what was measured at the jaw; needs --rig and --out. The estimators of the bench on all
    runs, then a transmission model fitted to some runs and held against others, beside regressions.

    Two sources or more: runs of an axis that one motor moves, without a jaw (EMPS, or CSV with theta_m_rad and
    tau_m_N_m). Terms of its inverse model are chosen and fitted on the first and held against the others; needs --rig
    for the radius, and --out.

    Parameters
    ----------
    source
        Recording, the folder of a `run`, another folder, zip or CSV.
    others
        More runs of an axis, to test on.
    rig
        For runs of an instrument: the rig file to estimate with; what it leaves `unknown` of ratio and offsets is
        fitted, nothing else.
    out
        Folder for tables and figures.
    algorithm
        For a recording: another estimator than the recorded one; then only its estimates are compared.
    black_boxes
        For runs of an instrument: gradient boosting and a network in the comparison too; needs scikit-learn. For runs
        of an axis: a network driven by the force alone, fitted from several seeds; some minutes more.
    map_
        Which column of a table is which of a run, and its unit: theta_m_rad=pos:deg; or a YAML of such lines
        (docs/measured-data.md).
    as_json
        The same as JSON; of runs of an instrument or an axis what is in instrument.json or axis_comparison.json.
    """
    if missing := [path for path in (source, *others) if not path.exists()]:
        raise UserError([f"{path}: no such file or folder" for path in missing])
    if others:
        if rig is None or out is None:
            raise UserError("runs of an axis need --rig RIG.yaml and --out DIR")
        if algorithm is not None:
            raise UserError("several sources are runs of an axis: --algorithm doesn't go with them")
        from hil_forceps.cli.commands.runs.replay_axis import replay_axis  # noqa: PLC0415 - scipy takes a while to load

        return replay_axis([source, *others], rig, out, read_map(map_), with_networks=black_boxes, as_json=as_json)
    if (source / RECORDING_NAME).is_file():
        source /= RECORDING_NAME
    if source.suffix.lower() == RECORDING_SUFFIX:
        return replay_recording(source, algorithm, as_json=as_json)
    if source.suffix.lower() in RIG_SUFFIXES:
        raise UserError(f"{source}: is no recording; a rig file goes behind --rig, the recording or run comes first")
    if rig is None or out is None:
        raise UserError(f"{source}: {_no_recording(source)}; runs of an instrument need --rig RIG.yaml and --out DIR")
    from hil_forceps.cli.commands.runs.replay_instrument import replay_instrument  # noqa: PLC0415 - as above

    return replay_instrument(source, rig, out, black_boxes, read_map(map_), as_json=as_json)


def _no_recording(source: Path) -> str:
    """Say what a source is that isn't a recording, and what would be one."""
    if source.is_dir():
        return f"holds no {RECORDING_NAME}; name the folder of a run, or its recording"
    if source.name.endswith(FAULT_NAME):
        return f"is the last second of a run, and that is not replayed; name its {RECORDING_NAME}, or see it by explain"
    return f"is no recording, which is named *{RECORDING_SUFFIX}"
