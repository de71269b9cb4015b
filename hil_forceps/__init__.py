"""Bridge and bench for wire-actuated surgical forceps. Not a medical device.

    import hil_forceps as hf

The names in `__all__` are the public API; docs/python-api.md has an example of each. Names in the subpackages may
change.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hil_forceps.api.diagnosis import DiagnosisResult, diagnose
    from hil_forceps.api.estimator import Estimator
    from hil_forceps.api.runs import read_runs
    from hil_forceps.api.service import Service, ServiceRun
    from hil_forceps.api.simulation import Simulation, simulate
    from hil_forceps.api.trend import TrendResult, track, trend
    from hil_forceps.api.virtual_bench import VirtualBench, virtual_bench
    from hil_forceps.control.trajectories import Trajectory
    from hil_forceps.data.run import Run
    from hil_forceps.rig import Rig, UserError, load_rig

__version__ = "0.1.0"

__all__ = [
    "DiagnosisResult",
    "Estimator",
    "Rig",
    "Run",
    "Service",
    "ServiceRun",
    "Simulation",
    "Trajectory",
    "TrendResult",
    "UserError",
    "VirtualBench",
    "diagnose",
    "load_rig",
    "read_runs",
    "simulate",
    "track",
    "trend",
    "virtual_bench",
]

# Module of each name. Importing this package loads none of them; a name is loaded at its first use.
# The layers below import `__version__` from here, so that this file must not import the API.
_HOMES = {
    "DiagnosisResult": "api.diagnosis",
    "Estimator": "api.estimator",
    "Rig": "rig",
    "Run": "data.run",
    "Service": "api.service",
    "ServiceRun": "api.service",
    "Simulation": "api.simulation",
    "Trajectory": "control.trajectories",
    "TrendResult": "api.trend",
    "UserError": "rig",
    "VirtualBench": "api.virtual_bench",
    "diagnose": "api.diagnosis",
    "load_rig": "rig",
    "read_runs": "api.runs",
    "simulate": "api.simulation",
    "track": "api.trend",
    "trend": "api.trend",
    "virtual_bench": "api.virtual_bench",
}


if not TYPE_CHECKING:  # else a type checker would accept any name

    def __getattr__(name: str) -> object:
        home = _HOMES.get(name)
        if home is None:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        value: object = getattr(import_module(f"{__name__}.{home}"), name)
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
