"""What was measured, with what is allowed: evidence in words and numbers."""

from typing import NamedTuple


class Measure(NamedTuple):
    """One value; a bound that is None isn't there."""

    name: str
    value: float
    unit: str
    least: float | None = None
    most: float | None = None

    @property
    def is_kept(self) -> bool:
        """Whether the value lies within its bounds."""
        return (self.least is None or self.value >= self.least) and (self.most is None or self.value <= self.most)

    def words(self) -> str:
        """Return name, value and bounds."""
        said = f"{self.name} {self.value:.4g} {self.unit}".rstrip()
        if self.least is not None and self.most is not None:
            return f"{said} ({self.least:.4g} to {self.most:.4g})"
        if self.most is not None:
            return f"{said} (at most {self.most:.4g})"
        return said if self.least is None else f"{said} (at least {self.least:.4g})"
