"""`hil-forceps replay`: the estimators run again on recordings, or on measured runs of real instruments."""

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
    """Run the estimators again on recorded data.

    Recording of `run` (.mcap): computes every reference again and compares it with the recorded one, byte for byte. If
    one differs, prints the first difference. Exit code 1 if one differs, or if a part of the recording is damaged or
    missing.

    Runs of a real instrument (folder or zip of the surgical-tool format, or CSV): estimates jaw torque and jaw angle
    from the motor side, and compares them with those measured at the jaw. Then fits a transmission model to some runs
    and tests it on others, together with regressions. Needs --rig and --out.

    Two or more sources: runs of a single axis with a motor and no jaw (EMPS, or CSV with theta_m_rad and tau_m_N_m).
    The terms of its inverse model are selected and fitted on the first source and tested on the others. Needs --rig,
    for the radius, and --out.

    Parameters
    ----------
    source
        Recording, folder of a run, other folder, zip or CSV.
    others
        Further runs of an axis, to test on.
    rig
        For runs of an instrument: rig file to estimate with. Of its values only ratio and offsets that are `unknown`
        are fitted.
    out
        Folder for tables and figures.
    algorithm
        For a recording: an estimator other than the recorded one; then only the estimates are compared.
    black_boxes
        For runs of an instrument: also compare gradient boosting and a neural network; needs scikit-learn. For runs of
        an axis: also compare a neural network with the force as its input, fitted from several seeds; takes minutes.
    map_
        Column of a table for a quantity of a run, with its unit, such as theta_m_rad=pos:deg; or a YAML file of such
        lines (docs/measured-data.md).
    as_json
        Print the result as JSON; for runs of an instrument or axis the content of instrument.json or
        axis_comparison.json.
    """
    if missing := [path for path in (source, *others) if not path.exists()]:
        raise UserError([f"{path}: no such file or folder" for path in missing])
    if others:
        if rig is None or out is None:
            raise UserError("several sources are runs of an axis, which need --rig and --out; add both")
        if algorithm is not None:
            raise UserError("--algorithm: not possible with several sources, which are runs of an axis; leave it out")
        from hil_forceps.cli.commands.runs.replay_axis import replay_axis  # noqa: PLC0415 - scipy takes a while to load

        return replay_axis([source, *others], rig, out, read_map(map_), with_networks=black_boxes, as_json=as_json)
    if (source / RECORDING_NAME).is_file():
        source /= RECORDING_NAME
    if source.suffix.lower() == RECORDING_SUFFIX:
        return replay_recording(source, algorithm, as_json=as_json)
    if source.suffix.lower() in RIG_SUFFIXES:
        raise UserError(f"{source}: is a rig file, not a recording; name a recording or run, and the rig with --rig")
    if rig is None or out is None:
        raise UserError(f"{source}: {_no_recording(source)}; for runs of an instrument add --rig and --out")
    from hil_forceps.cli.commands.runs.replay_instrument import replay_instrument  # noqa: PLC0415 - as above

    return replay_instrument(source, rig, out, black_boxes, read_map(map_), as_json=as_json)


def _no_recording(source: Path) -> str:
    """Say what a source is that isn't a recording, and what to name instead."""
    if source.is_dir():
        return f"contains no {RECORDING_NAME}; name the folder of a run, or its recording"
    if source.name.endswith(FAULT_NAME):
        return f"contains only the last second of a run; name its {RECORDING_NAME}, or use hil-forceps explain"
    return f"is not a recording (*{RECORDING_SUFFIX})"
