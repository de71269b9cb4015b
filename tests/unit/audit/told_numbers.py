"""Numbers that a finding tells in its text."""

import re
from typing import Any


def tells(text: str, number: Any) -> bool:
    """Whether a text has a number, or one that a `pytest.approx` takes for it."""
    return any(float(word) == number for word in re.findall(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?", text))
