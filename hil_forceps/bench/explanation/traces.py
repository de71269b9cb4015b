"""Series of the last second of a run, for its figure."""

import numpy as np

from hil_forceps.bench.explanation.evidence import Evidence
from hil_forceps.bridge.logs.flight_recorder import RECORDED_BEFORE_FAULT_NS
from hil_forceps.report.bench.fault import FaultTraces


def traces_of(evidence: Evidence) -> FaultTraces:
    """Return the series from one second before the end."""
    begin_ns = evidence.ended_ns - RECORDED_BEFORE_FAULT_NS
    samples = evidence.samples[evidence.samples["received_ns"] >= begin_ns]
    references = evidence.references[evidence.references["tick_ns"] >= begin_ns]
    lateness = evidence.lateness[evidence.lateness[:, 0] >= begin_ns]
    codes, rows = np.unique(references["verdict"], return_inverse=True)
    return FaultTraces(
        (samples["received_ns"] - evidence.ended_ns) / 1e9,
        samples["theta_m_rad"],
        samples["current_A"],
        (references["tick_ns"] - evidence.ended_ns) / 1e9,
        references["requested_rad"],
        references["passed_rad"],
        rows.astype(np.float64),
        tuple(evidence.verdicts.get(int(code), str(code)) for code in codes),
        (lateness[:, 0] - evidence.ended_ns) / 1e9,
        lateness[:, 1] / 1e3,
    )
