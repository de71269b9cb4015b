"""`virtual_bench`: simulated forceps with drive and bus, in virtual time, for programs and tests."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from itertools import count
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol, cast

import can
import numpy as np
from numpy.typing import NDArray

from hil_forceps.api.arguments import check_number, check_whole, kind, load_trajectory
from hil_forceps.api.runs import RigSource, as_rig
from hil_forceps.api.service import Service, ServiceRun
from hil_forceps.control.trajectories import PAPER_TRAJECTORY, Trajectory
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError

INTERFACE: Final = "virtual_forceps"  # an entry point of python-can: the world is opened like hardware
# Time between runs: the drive must detect that its host has ended (0.1 s without a heartbeat). The heartbeats of the
# next host count from the beginning and would be stale before.
PAUSE_NS: Final = 500_000_000
_channels = count()


class _TruthLog(Protocol):
    def columns(self) -> Mapping[str, NDArray[np.int64] | NDArray[np.float64]]:
        """Return the logged columns."""


class _World(Protocol):
    def now_ns(self) -> int:
        """Return virtual time."""

    def advance_until_ns(self, time_ns: int) -> None:
        """Advance the simulation to this time."""

    def shutdown(self) -> None:
        """Close the bus."""

    def truth_log(self) -> _TruthLog:
        """Return the log of the world's drive."""


class VirtualBench:
    """Simulated forceps on a bus; `interface` and `channel` are those of python-can, as for hardware."""

    interface = INTERFACE

    def __init__(self, rig: Rig, channel: str, world: _World) -> None:
        self.rig = rig  # of the simulated forceps
        self.channel = channel
        self._world = world
        self._has_run = False
        self._is_closed = False

    def _close(self) -> None:
        self._is_closed = True
        self._world.shutdown()

    def run(
        self,
        trajectory: Trajectory = PAPER_TRAJECTORY,
        duration_s: float | None = None,
        *,
        rig: RigSource | None = None,
        algorithm: str = "kalman",
        compensate: bool = True,
        out: str | PathLike[str] | None = None,
    ) -> ServiceRun:
        """Run the service with the simulated forceps, as `Service.run`; `rig`: the service's rig, if it differs.

        The next run continues with the same forceps, 0.5 s later; a remaining load moves the jaw meanwhile, because the
        drive gives no torque then. For a run from the initial state open another bench.
        """
        if self._is_closed:
            raise ValueError("run: the bench is closed, since its `with` block has ended; run within the block")
        if self._has_run:
            self._world.advance_until_ns(self._world.now_ns() + PAUSE_NS)
        self._has_run = True
        service = Service(
            self.rig if rig is None else rig,
            interface=self.interface,
            channel=self.channel,
            algorithm=algorithm,
            compensate=compensate,
        )
        return service.run(trajectory, duration_s, out=out)

    def truth(self) -> dict[str, NDArray[np.int64] | NDArray[np.float64]]:
        """Return the true values at each sample so far, in SI, with `stamp_ns` of the drive."""
        return dict(self._world.truth_log().columns())


class _Opening(AbstractContextManager[VirtualBench]):
    """Context manager of a bench."""

    def __init__(self, bench: AbstractContextManager[VirtualBench]) -> None:
        self._bench = bench

    def __enter__(self) -> VirtualBench:
        return self._bench.__enter__()

    def __exit__(self, *raised: Any) -> bool | None:
        return self._bench.__exit__(*raised)

    if not TYPE_CHECKING:  # type checkers report the missing attribute themselves

        def __getattr__(self, name: str) -> object:
            told = "the bench is not open; write `with hf.virtual_bench(...) as bench:` and in its block"
            raise AttributeError(f"{name}: {told} bench.{name}")


def virtual_bench(
    rig: RigSource,
    *,
    load_N_m: Trajectory | float = 0.0,
    seed: int = 0,
    faults: str | PathLike[str] | Sequence[object] | None = None,
    truth_duration_s: float = 60.0,
) -> AbstractContextManager[VirtualBench]:
    """Open a simulated bench of a rig in virtual time, as a context manager.

    The forceps has the rig's values, its sensors' noise and its `effects:`. Effects that the rig of the service lacks
    are hidden effects. It begins at rest with the jaw at 90 degrees. `load_N_m`: on the jaw, a number or a trajectory
    of torques from the first sample in operation on. The same `seed` gives the same bytes. `faults`: of the bus, a file
    or a list. `truth_duration_s`: duration for which true values are logged. UserError if the rig can't be simulated.
    """
    known = as_rig(rig)
    load = load_trajectory("load_N_m", load_N_m)
    check_whole("seed", seed)
    check_number("truth_duration_s", truth_duration_s, "s", is_positive=True)
    if faults is not None and not isinstance(faults, str | PathLike | Sequence):
        raise TypeError(f"faults: must be a list of faults, or the path of a file of them, not {kind(faults)}")
    options: dict[str, object] = {
        "rig": known,
        "load": list(zip(load.times_s, load.angles_rad, strict=True)),
        "seed": seed,
        "faults": Path(faults) if isinstance(faults, str | PathLike) else faults,
        "truth_duration_s": truth_duration_s,
    }
    return _Opening(_open(known, options))


@contextmanager
def _open(rig: Rig, options: Mapping[str, object]) -> Iterator[VirtualBench]:
    channel = f"virtual_bench{next(_channels)}"
    try:
        # ty: python-can accepts any option of the interface
        world = cast(_World, can.Bus(channel=channel, interface=INTERFACE, ignore_config=True, **options))  # type: ignore[arg-type]
    except can.CanInitializationError as error:
        raise UserError(str(error)) from error
    bench = VirtualBench(rig, channel, world)
    try:
        yield bench
    finally:
        bench._close()
