"""A wrong call of the API: one line that names the argument and what would be right, at once."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hil_forceps as hf

PAPER = Path(__file__).parents[3] / "configs" / "paper.yaml"
RIG = hf.load_rig(PAPER)
MOTION = hf.Trajectory((0.0, 0.2), (1.5, 1.4))
TIME_S = np.arange(20, dtype=np.float64) * 1e-3
RUN = hf.Run("a", {"time_s": TIME_S, "theta_m_rad": TIME_S, "current_A": TIME_S})
api: Any = hf  # what is called wrongly here is what a type checker would refuse

WRONG: list[tuple[Callable[[], object], str]] = [
    (lambda: api.load_rig(3), "path: must be the path of a rig file, not int"),
    (lambda: api.Estimator("kalman", 3, 1e-3), "rig: must be a Rig or the path of a rig file, not an int; hf.load_rig"),
    (lambda: api.Estimator(None, RIG, 1e-3), "algorithm: must be a text, not None"),
    (lambda: api.Estimator("kalman", RIG, "1e-3"), r"sample_time_s: must be a number \(s\), not a str"),
    (lambda: api.Estimator("kalman", RIG, 1e-3).step("0", 0.0), "theta_m_rad: must be a number, not a str"),
    (lambda: api.Estimator("kalman", RIG, 1e-3).step(TIME_S, TIME_S), "theta_m_rad: .* `estimate` takes a whole"),
    (
        lambda: api.Estimator("kalman", RIG, 1e-3).step(0.0, 0.0, 0.5),
        "stamp_ns: must be whole nanoseconds",
    ),
    (lambda: api.Estimator("kalman", RIG, 1e-3).estimate(["x"], [1.0]), "theta_m_rad: must be an array of numbers"),
    (lambda: RIG.with_changes(None), "changes: must be a mapping .* not NoneType"),  # type: ignore[arg-type]
    (lambda: RIG.with_changes([("encoder.counts_per_rev", 3)]), "changes: must be a mapping .* not list"),  # type: ignore[arg-type]
    (lambda: api.simulate(RIG, [RUN]), "like: must be a Run or a Trajectory, not a list"),
    (lambda: api.simulate(RIG, None), "like: must be a Run or a Trajectory, not None"),
    (lambda: api.simulate(None, MOTION), "rig: must be a Rig or the path of a rig file, not None"),
    (lambda: api.simulate(RIG, MOTION, load_N_m="1"), r"load_N_m: must be a number \(N m\) or a Trajectory of torques"),
    (lambda: api.simulate(RIG, MOTION, duration_s="1"), r"duration_s: must be a number \(s\), not a str"),
    (lambda: api.read_runs([RUN, RUN]), r"source 1: no runs can be read from a list; .* read_runs\(\*sources\)"),
    (lambda: api.read_runs(RUN, 3), "source 2: no runs can be read from an int: it must be a file, a table or a Run"),
    (lambda: api.read_runs(RUN, names="a"), r"names: must be a list of texts, not one; write \['a'\]"),
    (lambda: api.read_runs(RUN, names=[1]), "names: must be a list of texts, and one of these is an int"),
    (lambda: api.read_runs(RUN, columns="time_s=t"), "columns: must be a list of texts, not one"),
    (lambda: api.read_runs(RUN, node="1"), "node: must be a whole number, not a str"),
    (
        lambda: api.diagnose(RUN, RIG, without="cogging"),
        r"without: must be .* not one; write \['cogging'\]",
    ),
    (lambda: api.diagnose(RUN, RIG, hold_out="a"), "hold_out: must be a list of texts, not one"),
    (lambda: api.diagnose(RUN, RIG, seed="1"), "seed: must be a whole number, not a str"),
    (lambda: api.diagnose(RUN, RIG, jobs=1.5), "jobs: must be a whole number, not a float"),
    (lambda: api.diagnose(RUN, RIG, budget_s="1"), r"budget_s: must be a number \(s\), not a str"),
    (
        lambda: api.Run("a", {"time_s": [0, 1]}),
        r"columns\['time_s'\]: must be an array .* hf.read_runs",
    ),
    (lambda: api.Run("a", [TIME_S]), "columns: must be a mapping of names to arrays, not list"),
    (lambda: api.virtual_bench(RIG, seed="1"), "seed: must be a whole number, not a str"),
    (lambda: api.virtual_bench(RIG, seed=1.5), "seed: must be a whole number, not a float"),
    (lambda: api.virtual_bench(RIG, load_N_m=[1.0]), "load_N_m: must be a number .* not a list"),
    (lambda: api.virtual_bench(RIG, faults=3), "faults: must be a list of faults, .* not an int"),
    (lambda: api.virtual_bench(3), "rig: must be a Rig"),
    (lambda: api.Service(RIG, interface=None), "interface: must be a text, not None"),
    (lambda: api.Service(RIG, interface="virtual_forceps", options="a=1"), "options: must be a mapping"),
    (lambda: api.Service(RIG, interface="virtual_forceps", algorithm=4), "algorithm: must be a text, not an int"),
    (lambda: service().run([1.0, 2.0]), "trajectory: must be a Trajectory, not a list; write hf.Trajectory"),
    (lambda: service().run(MOTION, "2"), r"duration_s: must be a number \(s\), not a str"),
    (lambda: service().run(MOTION, out=3), "out: must be the path of a folder, not an int"),
]


def service() -> Any:
    return hf.Service(RIG, interface="virtual_forceps", channel="nobody")


@pytest.mark.parametrize(("call", "said"), WRONG)
def test_an_argument_of_another_kind(call: Callable[[], object], said: str) -> None:
    with pytest.raises(TypeError, match=f"^{said}") as refused:
        call()
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: hf.virtual_bench(RIG, load_N_m=float("nan")), r"load_N_m: is nan; must be a finite number \(N m\)"),
        (lambda: hf.virtual_bench(RIG, seed=-1), "seed: is -1; must be 0 or more"),
        (
            lambda: hf.virtual_bench(RIG, truth_duration_s=0.0),
            r"truth_duration_s: is 0\.0; must be .* above 0",
        ),
        (lambda: hf.simulate(RIG, MOTION, load_N_m=float("inf")), "load_N_m: is inf; must be a finite number"),
        (lambda: hf.simulate(RIG, MOTION, duration_s=-1.0), r"duration_s: is -1\.0; must be a finite number above 0"),
        (lambda: service().run(MOTION, 0.0), r"duration_s: is 0\.0; must be a finite number above 0"),
        (
            lambda: service().run(hf.Trajectory((-5.0, 1.0), (1.5, 1.4))),
            "trajectory: begins at -5 s, but its time counts from the first sample in operation; let it begin at 0",
        ),
        (lambda: hf.simulate(RIG, hf.Trajectory((-5.0, 1.0), (1.5, 1.4))), "like: begins at -5 s"),
        (lambda: hf.read_runs(RUN, names=["a", "b"]), "names: 1 runs need as many names that differ"),
    ],
)
def test_a_value_that_cannot_be(call: Callable[[], object], said: str) -> None:
    with pytest.raises(ValueError, match=f"^{said}"):
        call()


def test_a_column_that_was_not_measured() -> None:
    with pytest.raises(KeyError, match="foo: was not measured in a; there are time_s, theta_m_rad, current_A"):
        RUN["foo"]
    with pytest.raises(KeyError, match="foo: was not simulated; there are time_s, theta_m_ref_rad"):
        hf.simulate(RIG, MOTION)["foo"]


def test_a_service_without_a_line_is_refused_before_it_runs() -> None:
    with pytest.raises(hf.UserError, match=r"the drive's line is missing; give either a CAN interface .* serial"):
        hf.Service(RIG)
    with pytest.raises(hf.UserError, match="there are both; give either"):
        hf.Service(RIG, interface="socketcan", serial="/dev/ttyUSB0")


def test_a_bench_is_used_within_its_block() -> None:
    unopened: Any = hf.virtual_bench(RIG)
    with pytest.raises(AttributeError, match=r"run: the bench is not open; write `with hf\.virtual_bench"):
        unopened.run()
    with hf.virtual_bench(RIG) as bench:
        pass
    with pytest.raises(ValueError, match="run: the bench is closed, since its `with` block has ended"):
        bench.run()
