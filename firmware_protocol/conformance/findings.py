"""What a check may find: a violation of the requirement, or that it can't be told from here."""


class Violation(Exception):  # noqa: N818 - a finding, not an error of the program
    """The drive did what the requirement forbids; the text is the evidence."""


class Inconclusive(Exception):  # noqa: N818
    """It can't be told from here: something that the check needs was not to be had."""


class Disturbed(Exception):  # noqa: N818
    """Something outside moves the motor: no check says anything of the drive any more."""


def expect(condition: bool, finding: str) -> None:
    """Raise Violation with the finding unless the condition holds."""
    if not condition:
        raise Violation(finding)


def require(condition: bool, missing: str) -> None:
    """Raise Inconclusive unless the condition holds, which the check needs but does not judge."""
    if not condition:
        raise Inconclusive(missing)
