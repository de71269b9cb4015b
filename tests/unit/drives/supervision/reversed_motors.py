"""Simulated drives whose motor turns against its encoder."""

from typing import Any

import pytest

from virtual_bus.drives.registry import SIMULATED_DRIVES
from virtual_bus.plant.sensors import Reading


class Reversed:
    """A forceps whose motor turns against its loop; `tells` is the sign of the current that its drive tells."""

    def __init__(self, forceps: Any, tells: int) -> None:
        self._forceps, self._tells = forceps, tells
        self._theta = forceps.read(0).theta_m

    def __getattr__(self, name: str) -> Any:
        return getattr(self._forceps, name)

    def read(self, now_ns: int) -> Reading:
        """What a mini cheetah drive measures."""
        reading: Reading = self._forceps.read(now_ns)
        return reading._replace(current=self._tells * reading.current)

    def sample(self, now_ns: int, until_ns: int, reference: int | None) -> tuple[int, int, int, int]:
        followed = None if reference is None else 2 * self._theta - reference
        self._theta, current, theta_j, tau_w = self._forceps.sample(now_ns, until_ns, followed)
        return self._theta, self._tells * current, theta_j, tau_w


def reverse(monkeypatch: pytest.MonkeyPatch, profile: str, tells: int) -> None:
    """Reverse the simulated drives of a profile; `tells` is the sign of the current that they tell."""
    kind = SIMULATED_DRIVES[profile]

    def made(*arguments: Any, **keywords: Any) -> Any:
        drive: Any = kind(*arguments, **keywords)
        if profile == "mit":  # which closes its loop itself
            wanted_A, drive._wanted_A = drive._wanted_A, lambda: -wanted_A()
        drive._forceps = Reversed(drive._forceps, tells)
        return drive

    monkeypatch.setitem(SIMULATED_DRIVES, profile, made)
