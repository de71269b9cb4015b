"""`hil-forceps` for a guest in virtual time: the same, but the host never spins, for there no sleep ends late."""

from hil_forceps.bridge.clocks import MonotonicClock
from hil_forceps.bridge.links import adapters
from hil_forceps.cli.main import main

if __name__ == "__main__":
    adapters.MonotonicClock = lambda _: MonotonicClock(0)  # type: ignore[attr-defined,misc,assignment]
    main()
