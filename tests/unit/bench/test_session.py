"""A session says when it began, but not in virtual time, where the same seed gives the same bytes."""

from datetime import UTC, datetime
from pathlib import Path

import pytest

from hil_forceps.api.batch.work import recorded_begin
from hil_forceps.bench.assembly import Settings
from hil_forceps.bench.session import Plan, run_session, service_config, stamps_are_host_time
from hil_forceps.bridge.clocks import VirtualClock
from hil_forceps.bridge.links.adapters import Connection
from hil_forceps.bridge.links.can_link import VirtualTimeLink
from hil_forceps.control.trajectories import PAPER_TRAJECTORY
from hil_forceps.drives.registry import machine_for, sample_period_s
from hil_forceps.rig import load_rig
from virtual_bus.interface import VirtualForcepsBus

RIG = load_rig(str(Path(__file__).parents[3] / "configs" / "paper.yaml"))


@pytest.mark.parametrize("virtual_time", [True, False])
def test_a_recording_says_when_it_began_unless_time_is_virtual(tmp_path: Path, virtual_time: bool) -> None:
    bus = VirtualForcepsBus("dated", rig=RIG, simulation=0)
    settings = Settings("kalman", True, sample_period_s(RIG), PAPER_TRAJECTORY, stamps_are_host_time(RIG))
    recording = tmp_path / "run.mcap"
    plan = Plan(RIG, settings, machine_for(RIG), service_config(RIG, 0.2), recording, tmp_path / "bus.log", {})
    earliest = datetime.now(UTC).replace(microsecond=0)
    run_session(Connection(VirtualTimeLink(bus), VirtualClock(bus), virtual_time, ()), plan)
    bus.shutdown()
    begun = recorded_begin(recording)
    if virtual_time:
        assert begun == ""
    else:
        assert earliest <= datetime.fromisoformat(begun) <= datetime.now(UTC)
