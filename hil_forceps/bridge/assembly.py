"""From a rig to a pipeline and a service, and how a recording says which rig that was."""

import json
from collections.abc import Mapping
from typing import NamedTuple

from firmware_protocol.host_machine import HostConfig
from firmware_protocol.messages import PROTOCOL_MAJOR, PROTOCOL_MINOR
from hil_forceps import __version__
from hil_forceps.bridge.pipeline import VERDICT_NAMES, Pipeline
from hil_forceps.bridge.results import ServiceConfig
from hil_forceps.control.gate import DEFAULT_MAX_GAP_S, Gate
from hil_forceps.control.trajectories import PAPER_TRAJECTORY, Trajectory
from hil_forceps.estimation.registry import ESTIMATOR_IDS, make_estimator
from hil_forceps.rig import Rig, dump_rig, parse_rig
from hil_forceps.rig.errors import UserError
from hil_forceps.runs.recording_format import FORMAT_VERSION
from hil_forceps.runs.recording_writer import Outcome

GAP_HOST_PERIODS = 5  # a slow loop may leave longer gaps between references than the gate's default


class Experiment(NamedTuple):
    """All that decides which references a stream of samples gives, with what it was recorded for."""

    rig: Rig
    algorithm: str
    compensated: bool
    trajectory: Trajectory = PAPER_TRAJECTORY
    same_clock: bool = False  # the drive's stamps are the host's clock: virtual time, and no drive_clock_ppm
    simulation: int = 0  # of the paper, 0 for none
    seed: int = 0


def make_pipeline(experiment: Experiment) -> Pipeline:
    """Build a fresh pipeline; UserError when the rig doesn't know what the algorithm needs."""
    rig, period_s = experiment.rig, experiment.rig.bench.host_period_s
    sample_time_s = rig.require_drive().sample_time_s * rig.bench.feedback_divider
    return Pipeline(
        estimator=make_estimator(experiment.algorithm, rig, sample_time_s),
        trajectory=experiment.trajectory,
        plant=rig.plant(),
        gate=Gate(rig.limits, max_gap_s=max(DEFAULT_MAX_GAP_S, GAP_HOST_PERIODS * period_s)),
        compensate=experiment.compensated,
        max_sample_age_s=rig.limits.max_sample_age_s,
        same_clock=experiment.same_clock,
    )


def make_host_config(rig: Rig) -> HostConfig:
    """Return the settings of the host's end of the protocol."""
    return HostConfig(rig.bench.node_id, fd=rig.bench.transport == "fd")


def make_service_config(rig: Rig, duration_s: float | None) -> ServiceConfig:
    """Return the loop's times; `duration_s` counts from the zero of the experiment, None is no end.

    A loop slower than 1 kHz takes its time in proportion before a drive counts as silent.
    """
    period_ns = round(rig.bench.host_period_s * 1e9)
    slower = max(1, period_ns // 1_000_000)
    return ServiceConfig(
        period_ns=period_ns,
        phase_ns=round(rig.bench.host_phase_s * 1e9) % period_ns,
        duration_ns=None if duration_s is None else round(duration_s * 1e9),
        silence_timeout_ns=ServiceConfig().silence_timeout_ns * slower,
    )


def to_metadata(experiment: Experiment, start: str) -> dict[str, str]:
    """Return what a recording says of its origin; `start` is a date, or says that time was virtual."""
    trajectory = {"times_s": experiment.trajectory.times_s, "angles_rad": experiment.trajectory.angles_rad}
    return {
        "format_version": str(FORMAT_VERSION),
        "package_version": __version__,
        "protocol_version": f"{PROTOCOL_MAJOR}.{PROTOCOL_MINOR}",
        "start": start,
        "algorithm": experiment.algorithm,
        "compensated": json.dumps(experiment.compensated),
        "same_clock": json.dumps(experiment.same_clock),
        "simulation": str(experiment.simulation),
        "seed": str(experiment.seed),
        "trajectory": json.dumps(trajectory),
        "verdicts": json.dumps({str(code): name for code, name in sorted(VERDICT_NAMES.items())}),
        "outcomes": json.dumps({str(int(outcome)): outcome.name for outcome in Outcome}),
        "rig": dump_rig(experiment.rig),
    }


def from_metadata(metadata: Mapping[str, str], name: str) -> Experiment:
    """Return what was recorded; UserError naming the file `name` when its metadata doesn't say."""
    try:
        if metadata["format_version"] != str(FORMAT_VERSION):
            raise UserError(f"{name}: format {metadata['format_version']}, this version reads {FORMAT_VERSION}")
        points = json.loads(metadata["trajectory"])
        experiment = Experiment(
            rig=parse_rig(metadata["rig"], f"{name} (rig)"),
            algorithm=metadata["algorithm"],
            compensated=json.loads(metadata["compensated"]) is True,
            trajectory=Trajectory(tuple(points["times_s"]), tuple(points["angles_rad"])),
            same_clock=json.loads(metadata["same_clock"]) is True,
            simulation=int(metadata["simulation"]),
            seed=int(metadata["seed"]),
        )
    except (KeyError, ValueError, TypeError) as error:
        raise UserError(f"{name}: its metadata can't be understood: {error!r}") from error
    if experiment.algorithm not in ESTIMATOR_IDS:
        raise UserError(f"{name}: algorithm {experiment.algorithm!r} is unknown; known: {', '.join(ESTIMATOR_IDS)}")
    return experiment
