"""The audit: what is wrong with the data themselves, found before any physics is fitted to them."""

from collections.abc import Iterator, Sequence

from hil_forceps.audit.balance import audit_kinematics, audit_torque
from hil_forceps.audit.channels import audit_channels
from hil_forceps.audit.finding import Finding, Severity, View
from hil_forceps.audit.law import audit_law
from hil_forceps.audit.runs import audit_excitation, audit_together
from hil_forceps.audit.stamps import audit_stamps
from hil_forceps.audit.strokes import audit_strokes
from hil_forceps.data.even_rows import even_rows
from hil_forceps.data.run import Run
from hil_forceps.rig.schema import Rig

_ORDER: tuple[Severity, ...] = ("problem", "warning", "note")


def audit(runs: Sequence[Run], rig: Rig | None) -> list[Finding]:
    """Return what the runs show by themselves, against each other and against the rig; problems first.

    Looks at stamps, quanta, stuck and clipped channels, noise, spikes, shifts, signs, units, the drive's law, the
    pulleys' ratio, duplicates, a gear's counts, zeros of the torques, and what the runs excite; without a rig, at
    what needs none. Nothing is changed in the runs. Takes the time of some FFTs and sorts over the rows. A channel
    that gives one finding of a kind gives no second of it.
    """
    views = [View(run) for run in runs]
    found: dict[tuple[str, str, str], Finding] = {}
    for finding in _findings(views, rig):
        key = (finding.kind, finding.run, finding.channel if finding.kind != "reader" else finding.text)
        found.setdefault(key, finding)
    return sorted(found.values(), key=lambda finding: _ORDER.index(finding.severity))


def _filled(view: View, rig: Rig | None) -> View:
    """Return a run with its lost rows filled where they are few: what it does isn't told by its longest whole piece."""
    if rig is None:
        return view
    even = even_rows(view.run, rig)
    return view if even is None or not even.lost.any() else View(even.run)


def _findings(views: Sequence[View], rig: Rig | None) -> Iterator[Finding]:
    for view in views:
        yield from audit_stamps(view, rig)
        yield from audit_channels(view, rig)
        whole = _filled(view, rig)
        yield from audit_kinematics(whole, rig)
        yield from audit_law(view, rig)
        if rig is not None:
            has_law = rig.drive is not None and {"theta_m_ref_rad", "current_A"} <= view.columns.keys()
            yield from audit_torque(whole, rig, has_law)
        yield from audit_excitation(whole)
    yield from audit_together(views)
    yield from audit_strokes(views, law_known=rig is not None and rig.drive is not None)
