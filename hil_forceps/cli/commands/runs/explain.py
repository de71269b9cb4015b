"""`hil-forceps explain`: the events of a run, what ended it, and likely causes."""

import json
import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from hil_forceps.bench.explanation.evidence import Evidence, read_evidence
from hil_forceps.bench.explanation.story import json_of, story_of, text_of
from hil_forceps.bench.run_folder import RECORDING_NAME
from hil_forceps.cli.arguments.files import make_folder, recording_of
from hil_forceps.data.recording.format import FAULT_NAME


def explain(
    run: Path, *, out: Path | None = None, as_json: Annotated[bool, Parameter(name="--json", negative="")] = False
) -> int:
    """List the events of a run, what ended it, the last samples, likely causes and what to check.

    Reads complete and truncated recordings, also those of older versions, and fault.json, which has the last second
    before a fault. If there is only a fault.json, the list covers that second.

    Parameters
    ----------
    run
        Folder of a run, its recording, or a fault.json.
    out
        Folder for the figure of the last second (fault.png, fault.pdf).
    as_json
        Print the result as JSON.
    """
    evidence = read_evidence(_source(run))
    story = story_of(evidence)
    if out is not None:
        _draw(evidence, out)
    sys.stdout.write(json.dumps(json_of(story), indent=2) if as_json else "\n".join(text_of(story)))
    sys.stdout.write("\n")
    return 0


def _source(run: Path) -> Path:
    if run.is_dir() and not (run / RECORDING_NAME).is_file() and (run / FAULT_NAME).is_file():
        return run / FAULT_NAME
    return recording_of(run)


def _draw(evidence: Evidence, out: Path) -> None:
    from hil_forceps.bench.explanation.traces import traces_of  # noqa: PLC0415 - matplotlib, for figures only
    from hil_forceps.report.bench.fault import fault_figure  # noqa: PLC0415
    from hil_forceps.report.save import save_figure  # noqa: PLC0415

    make_folder(out)
    title = f"{evidence.reason.replace('_', ' ') or 'end'}: {evidence.message.partition(';')[0]}"
    save_figure(fault_figure(traces_of(evidence), title), out, "fault")
