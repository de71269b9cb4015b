"""The first call in a process: nothing has been compiled, and nothing but the cache is there."""

import subprocess
import sys
from pathlib import Path

from hil_forceps.estimation.registry import ALGORITHMS

ROOT = Path(__file__).parents[3]
# One process that has loaded everything and called nothing; each call is then the first one of a process of its own.
PROGRAM = """
import os
import numpy as np
from hil_forceps.api.estimator import Estimator
from hil_forceps.estimation.direct import plant_steps, run_direct
from hil_forceps.estimation.registry import ALGORITHMS, make_estimator
from hil_forceps.rig import load_rig

def whole(name, rig):
    time_s = np.arange(5) * 1e-3
    found = Estimator(name, rig, 1e-3).estimate(0.1 * time_s, time_s, time_s)
    assert np.all(np.isfinite(found.tau_w_N_m))

def in_closed_loop(name, rig):
    estimator = make_estimator(name, rig, rig.require_drive().sample_time_s)
    assert np.all(np.isfinite(run_direct(rig, estimator, np.ones(5), np.zeros(5 * plant_steps(rig))).theta_m_rad))

plain = load_rig("configs/paper.yaml")
corrected = plain.with_changes({"effects": {"cogging": {"sine_N_m": 1e-4, "cosine_N_m": 0.0, "harmonic": 12}}})
calls = [(whole, name, plain) for name in ALGORITHMS]
calls += [(whole, "improved", corrected), (in_closed_loop, "previous", plain)]
for call, name, rig in calls:
    if not os.fork():
        try:
            call(name, rig)
        except BaseException as error:
            print(name, call.__name__, repr(error)[:200], flush=True)
            os._exit(1)
        os._exit(0)
    os.wait()
print("asked", len(ALGORITHMS))
"""


def test_every_algorithm_is_ready_as_the_first_thing_that_a_process_does() -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.stdout, done.returncode) == (f"asked {len(ALGORITHMS)}\n", 0), done.stderr
