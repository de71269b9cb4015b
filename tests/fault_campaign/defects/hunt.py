"""Looks for a defect with the campaign's own schedules: how many seeds it takes."""

from typing import NamedTuple

import pytest

from tests.fault_campaign.campaign import Verdict, judge, names_of
from tests.fault_campaign.defects.table import Defect
from tests.fault_campaign.schedule import Schedule, draw


class Catch(NamedTuple):
    """The first schedule in which a defect showed as what it is."""

    seeds: int  # that were run, this one among them
    schedule: Schedule
    verdict: Verdict


def hunt(defect: Defect, most: int) -> Catch | None:
    """Run the defect's schedules, at most so many, until an invariant tells that should; None where none does."""
    with pytest.MonkeyPatch.context() as patch:
        defect.plant(patch)
        for seed in range(most):
            schedule = draw(seed, defect.profiles[seed % len(defect.profiles)], defect.among)
            verdict = judge(schedule, again="same bytes" in defect.caught_by)
            if names_of(verdict.findings) & defect.caught_by:
                return Catch(seed + 1, schedule, verdict)
    return None
