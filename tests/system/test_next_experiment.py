"""Two effects tied on a small arc; the experiment that the diagnosis asks for, made on the bench, tells them apart."""

from pathlib import Path

import pytest

from hil_forceps.bench.assembly import Settings
from hil_forceps.bench.session import Plan, run_session, service_config
from hil_forceps.bridge.links.adapters import LinkSpec, open_link
from hil_forceps.cli.arguments.trajectory_file import read_trajectory, write_trajectory
from hil_forceps.control.trajectories import Trajectory
from hil_forceps.data.even_rows import EvenRun, even_rows
from hil_forceps.data.readers.read_run import read_run
from hil_forceps.data.run import Run
from hil_forceps.diagnosis import identification
from hil_forceps.diagnosis.experiment_design.next_experiment import MOST_RIVALS, propose
from hil_forceps.diagnosis.identification import Identified, identify
from hil_forceps.diagnosis.options import Options
from hil_forceps.diagnosis.validation.numbers import detectable
from hil_forceps.drives.registry import machine_for, sample_period_s
from hil_forceps.rig import Rig
from hil_forceps.rig.catalogue import EFFECT_IDS
from tests.hidden_effects.generator import RIG, make_case

LIMITED = RIG.with_changes(
    {
        "limits.position_min_rad": -1.2,
        "limits.position_max_rad": 1.2,
        "limits.speed_max_rad_per_s": 40.0,
        "limits.acceleration_max_rad_per_s2": 2e4,
    }
)
TIED = {"pulley_eccentricity", "spool_radius_change"}
# The whole catalogue takes three times as long and names the same.
LOOKED_FOR = TIED | {"encoder_scale", "encoder_eccentricity", "wire_hardening", "wire_slack", "jaw_gravity"}
BELOW = 1.5  # how many times less than predicted may be reached
ABOVE = 2.0  # and more: predicted is what four of five cases reach, not their mean


def identified(runs: list[Run], held: Run, rig: Rig) -> Identified:
    without = frozenset(EFFECT_IDS) - LOOKED_FOR
    return identify([evenly(run, rig) for run in runs], [evenly(held, rig)], rig, Options(without))


def evenly(run: Run, rig: Rig) -> EvenRun:
    found = even_rows(run, rig)
    assert found is not None
    return found


def on_the_bench(rig: Rig, trajectory: Trajectory, out: Path) -> Run:
    """Make the run as `hil-forceps run` does, in virtual time."""
    link = LinkSpec(interface="virtual_forceps", channel=out.name, options={"rig": rig, "simulation": 0, "seed": 3})
    period_s = sample_period_s(rig)
    plan = Plan(
        rig,
        Settings("kalman", False, period_s, trajectory, same_clock=True),
        machine_for(rig),
        service_config(rig, trajectory.times_s[-1]),
        recording=out / "run.mcap",
        bus_log=out / "bus.log",
        about={},
    )
    session = run_session(open_link(link), plan)
    assert session.service.ok, session.service.message
    assert session.failures == []
    (run,) = read_run(out / "run.mcap")
    return run


def apart(found: Identified) -> float:
    """Return how much less the eccentric pulley leaves than the growing spool, in χ²."""
    gain = {model.effects[-1]: model.gain for model in found.found.steps[0].tried}
    # Its second parameter costs it 2 in the gain.
    return gain["pulley_eccentricity"] + 2.0 - gain["spool_radius_change"]


@pytest.mark.xfail(reason="the filter's foresight: d of 41 is predicted, 25 is achieved (decisions/0028)")
@pytest.mark.long
@pytest.mark.timeout(900)
def test_the_experiment_separates_as_predicted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(identification, "MOST_EFFECTS", 1)  # which one it is, is asked; not what might come on top
    case = make_case(
        {"pulley_eccentricity": {"cosine": 0.0, "sine": 0.004}}, 8, scenarios=(("trapezoid",), ()), rig=LIMITED
    )
    held = Run("held", case.fit[0].columns)
    first = identified([case.fit[0]], held, LIMITED)
    models = {rival.effects: rival for rival in first.found.rivals}
    assert set(models) == {(effect_id,) for effect_id in TIED}
    proposal = propose(first, LIMITED, [case.fit[0]], detectable(first.found.steps[0]), map)
    assert len(models) <= MOST_RIVALS
    assert {name for ids in proposal.result.separates for name in ids} == TIED
    predicted = proposal.result.predicted_separation

    path = tmp_path / "next_experiment.csv"
    write_trajectory(proposal.trajectory, path)
    made = on_the_bench(case.true, read_trajectory(path), tmp_path)
    second = identified([case.fit[0], made], held, LIMITED)

    assert [rival.effects for rival in second.found.rivals] == [("pulley_eccentricity",)]
    achieved = (apart(second) - apart(first)) ** 0.5
    assert predicted / BELOW < achieved < predicted * ABOVE
