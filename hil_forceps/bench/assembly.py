"""Build a pipeline from a rig and settings, and read both back from a recording."""

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any, NamedTuple

from firmware_protocol.messages import PROTOCOL_MAJOR, PROTOCOL_MINOR
from hil_forceps import __version__
from hil_forceps.bench.matrix import RunSpec
from hil_forceps.bridge.pipeline import VERDICT_NAMES, Pipeline
from hil_forceps.control.gate import DEFAULT_MAX_GAP_S, Gate
from hil_forceps.control.gate.bounds import feedback_bounds
from hil_forceps.control.trajectories import Trajectory
from hil_forceps.data.recording.reader import Recording
from hil_forceps.data.recording.writer import Outcome
from hil_forceps.data.strict_json import parse_json
from hil_forceps.estimation.registry import ALGORITHMS, ESTIMATOR_IDS, make_estimator
from hil_forceps.rig import Rig, dump_rig, parse_rig
from hil_forceps.rig.errors import UserError

MAX_GAP_PERIODS = 5
MAX_STEP_PERIODS = 2  # travel of a reference within it is limited as a native drive does by default (HFP-116)
MAX_SAMPLE_TIME_S = 100.0  # the rig's longest, a thousand times over


class Settings(NamedTuple):
    """Settings of a pipeline, besides the rig."""

    algorithm: str
    compensated: bool
    sample_time_s: float  # nominal interval of the samples
    trajectory: Trajectory | None  # of the jaw angle; None with external references
    same_clock: bool = False  # the drive's stamps are the host's own clock


# Sections that the estimator uses; the others belong to bench and drive.
BELIEVED = ("forceps", "motor", "encoder", "noise", "estimators", "effects")


class Rigs(NamedTuple):
    """The rig of the plant, and that of the estimator."""

    plant: Rig
    estimator: Rig


def rigs_for(spec: RunSpec, rig: Rig, estimator_rig: Rig | None) -> Rigs:
    """Return the rig of the plant, and that of the estimator, with the sections of `estimator_rig` if the run has one.

    ValueError if the run needs one and there is none.
    """
    if not spec.estimator_rig:
        return Rigs(rig, rig)
    if estimator_rig is None:
        raise ValueError(f"{spec.name} wants a rig for its estimator")
    return Rigs(rig, rig.model_copy(update={section: getattr(estimator_rig, section) for section in BELIEVED}))


def gate_for(rig: Rig, sample_time_s: float) -> Gate:
    """Return the rig's gate, with times that allow for a slow host."""
    period_s = rig.bench.host_period_s
    step_s = MAX_STEP_PERIODS * max(period_s, sample_time_s)
    return Gate(rig.limits, feedback_bounds(rig), max(DEFAULT_MAX_GAP_S, MAX_GAP_PERIODS * period_s), step_s)


def make_pipeline(rig: Rig, settings: Settings, outside: Callable[[float], float] | None = None) -> Pipeline:
    """Combine estimator, trajectory and gate; UserError for an unknown algorithm or a rig without required values.

    `outside`: source of the jaw's reference if the settings have no trajectory. ValueError if there is neither.
    """
    reference = settings.trajectory or outside
    if reference is None:
        raise ValueError("a pipeline needs a trajectory, or references from outside")
    if settings.algorithm not in ALGORITHMS:
        raise UserError(f"unknown algorithm '{settings.algorithm}'; use one of {', '.join(ESTIMATOR_IDS)}")
    return Pipeline(
        make_estimator(settings.algorithm, rig, settings.sample_time_s),
        reference,
        rig.plant(),
        gate_for(rig, settings.sample_time_s),
        settings.compensated,
        rig.limits.max_sample_age_s,
        same_clock=settings.same_clock,
    )


def metadata(rig: Rig, settings: Settings, more: Mapping[str, str]) -> dict[str, str]:
    """Return the metadata of a recording, from which the same pipeline can be built again."""
    trajectory = None if settings.trajectory is None else asdict(settings.trajectory)
    return {
        "version": __version__,
        "protocol": f"{PROTOCOL_MAJOR}.{PROTOCOL_MINOR}",
        "rig": dump_rig(rig),
        "settings": json.dumps({**settings._asdict(), "trajectory": trajectory}),
        "verdicts": json.dumps(VERDICT_NAMES),
        "outcomes": json.dumps({int(outcome): outcome.name for outcome in Outcome}),
        **more,
    }


def settings_of(recording: Recording) -> tuple[Rig, Settings]:
    """Return the rig and the settings of a recording; UserError if they can't be read."""
    try:
        rig = parse_rig(recording.metadata["rig"], f"{recording.name}: rig")
        return rig, _settings(parse_json(recording.metadata["settings"]))
    except (KeyError, TypeError, ValueError) as error:
        raise UserError(f"{recording.name}: its rig and settings can't be read ({error})") from error


def _settings(values: Any) -> Settings:
    """Return settings from JSON; TypeError or ValueError if they are not valid."""
    if not isinstance(values, dict) or not isinstance(points := values.get("trajectory", 0), dict | None):
        raise TypeError("no settings with a trajectory")
    trajectory = None if points is None else Trajectory(**{name: _numbers(each) for name, each in points.items()})
    settings = Settings(**{**values, "trajectory": trajectory})
    if not isinstance(values.get("algorithm"), str):
        raise TypeError("an algorithm that is no name")
    if not all(isinstance(value, bool) for value in (settings.compensated, settings.same_clock)):
        raise TypeError("a yes or no that is neither")
    (sample_time_s,) = _numbers([settings.sample_time_s])
    if not 0.0 < sample_time_s <= MAX_SAMPLE_TIME_S:
        raise ValueError(f"a sample time of {sample_time_s} s")
    return settings


def _numbers(values: object) -> tuple[float, ...]:
    if not isinstance(values, list) or not all(type(value) in {int, float} for value in values):
        raise TypeError("no list of numbers")
    return tuple(map(float, values))
