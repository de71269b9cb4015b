"""`diagnosis.json`: the contract's keys, plain numbers, nothing that isn't JSON."""

import json
import math

from hil_forceps.audit.finding import Finding
from hil_forceps.diagnosis.result import (
    Candidate,
    Detectable,
    Diagnosis,
    Estimate,
    Gain,
    NamedEffect,
    NextExperiment,
    Shift,
    to_json,
)

KEYS = {
    "schema",
    "verdict",
    "effects",
    "candidate_sets",
    "parameter_shifts",
    "gain",
    "held_out",
    "data_audit",
    "minimum_detectable",
    "next_experiment",
}


def full() -> Diagnosis:
    width = Estimate(2e-6, 1e-6, 3e-6, "m")
    return Diagnosis(
        "effects",
        "The data show slack.",
        (NamedEffect("wire_slack", "wire", 0.9, {"half_width_m": width}),),
        (("wire_slack",), ("wire_creep", "cogging")),
        {"forceps.wire_stiffness_N_per_m": Shift(None, Estimate(3e4, 2.9e4, 3.1e4, "N_per_m"))},
        {"theta_m_rad": Gain(2e-3, 1e-3, 1e-3, 1.0, 0.9, math.nan)},
        ("b",),
        (Finding("gap", "warning", "a", "time_s", "a gap"),),
        {"cogging": Detectable("sine_N_m", 1e-5, "N_m")},
        NextExperiment("chirp", (("a", "b"),), 12.0),
        candidates=(Candidate("wire_slack", 0, math.inf, 14.0, "named"),),
    )


def test_the_json_has_the_contract_s_keys_and_form() -> None:
    data = to_json(full())
    assert set(data) >= KEYS
    assert data["schema"] == 1
    assert data["effects"] == [
        {
            "id": "wire_slack",
            "confidence": 0.9,
            "location": "wire",
            "parameters": {"half_width_m": {"value": 2e-6, "unit": "m", "ci95": [1e-6, 3e-6]}},
        }
    ]
    assert data["candidate_sets"] == [["wire_slack"], ["wire_creep", "cogging"]]
    shift = data["parameter_shifts"]["forceps.wire_stiffness_N_per_m"]
    assert shift == {"assumed": None, "fitted": 3e4, "unit": "N_per_m", "ci95": [2.9e4, 3.1e4]}
    assert data["held_out"] == ["b"]
    assert data["minimum_detectable"] == {"cogging": {"parameter": "sine_N_m", "value": 1e-5, "unit": "N_m"}}
    assert data["next_experiment"]["separates"] == [["a", "b"]]


def test_numbers_that_are_none_become_null_and_strict_json_takes_it() -> None:
    data = json.loads(json.dumps(to_json(full()), allow_nan=False))
    assert data["gain"]["theta_m_rad"]["ci95"] == [0.9, None]
    assert data["candidates"][0]["score"] is None


def test_an_empty_diagnosis_has_every_key() -> None:
    data = to_json(Diagnosis("undetermined", "No verdict is possible."))
    assert set(data) >= KEYS
    assert data["effects"] == []
    assert data["parameter_shifts"] == {}
    assert data["next_experiment"] is None
