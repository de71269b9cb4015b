"""Traces of a bench run, from its recording, for metrics and figures."""

import numpy as np

from hil_forceps.bench.matrix import RunSpec
from hil_forceps.control.trajectories import Trajectory
from hil_forceps.data.recording.reader import Recording, match_bench
from hil_forceps.report.traces import RunTraces
from hil_forceps.rig.plant import PlantParameters


def traces_of(recording: Recording, spec: RunSpec, plant: PlantParameters, trajectory: Trajectory) -> RunTraces:
    """Align estimates and the bench's sensors on the time axis of the drive's samples, from the zero on.

    The true elongation is r_m·θ_m − r_j·θ_j (3) from encoder and jaw sensor at the same instant, so that it is as fine
    as the encoder. Samples without bench values are left out.
    """
    index = match_bench(recording.samples, recording.bench)
    zero_ns = recording.zero_ns
    rows = np.flatnonzero(index >= 0)
    if zero_ns is None or not rows.size:
        rows, zero_ns = rows[:0], 0
    rows = rows[recording.samples["stamp_ns"][rows] >= zero_ns]
    samples, bench = recording.samples[rows], recording.bench[index[rows]]
    time_s = (samples["stamp_ns"] - zero_ns) * 1e-9
    return RunTraces(
        time_s=time_s,
        tau_w_true=np.asarray(bench["tau_w_N_m"]),
        tau_w_est=np.asarray(samples["tau_w_estimate_N_m"]),
        theta_j_true=np.asarray(bench["theta_j_rad"]),
        theta_j_ref=trajectory.angles(time_s),
        x_true=plant.motor_pulley_radius_m * samples["theta_m_rad"] - plant.jaw_pulley_radius_m * bench["theta_j_rad"],
        x_est=np.asarray(samples["elongation_estimate_m"]),
        algorithm=spec.algorithm,
        compensated=spec.compensated,
        simulation=spec.simulation,
        sample_time_s=spec.sample_time_s,
    )
