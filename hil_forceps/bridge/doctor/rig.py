"""The rig by itself: what `hil-forceps check` finds, each finding a check."""

from collections.abc import Iterator
from typing import Final

from hil_forceps.bridge.doctor.check import Check, Verdict
from hil_forceps.drives.compatibility.lint import findings
from hil_forceps.drives.registry import machine_for
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError

_WHAT: Final = "hil-forceps check"


def checks(rig: Rig) -> Iterator[Check]:
    """Look at the rig."""
    try:
        machine_for(rig)
    except UserError as error:
        for problem in error.problems:
            key, colon, text = problem.partition(": ")
            found = (f"rig.{key}", text) if colon else ("rig.settings", problem)
            yield Check(found[0], _WHAT, Verdict.FAIL, found[1], "change it in the rig file")
        return
    settings = findings(rig)
    for finding in settings:
        verdict = Verdict.FAIL if finding.level == "problem" else Verdict.WARN
        yield Check(f"rig.{finding.key}", _WHAT, verdict, finding.text, _remedy(finding.key))
    if not settings:
        yield Check("rig.settings", _WHAT, Verdict.OK, "the settings are consistent")


def _remedy(key: str) -> str:
    """Return what to do about a finding at a key."""
    if key == "encoder.counts_per_rev":  # of the hardware: another number in the rig would only be wrong
        return "none, if this is the encoder's resolution: use a finer encoder, or accept the noise of the estimates"
    return f"change {key} in the rig file"
