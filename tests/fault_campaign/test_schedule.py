"""Schedules: the same seed draws the same, as data and back, and what fails is shrunk."""

import pytest

from tests.fault_campaign.rigs import HORIZON_NS
from tests.fault_campaign.schedule import DRAWS, Fault, Kind, Schedule, draw, from_json
from tests.fault_campaign.shrink import shrink

MS = 1_000_000


def test_the_same_seed_draws_the_same() -> None:
    assert [draw(seed) for seed in range(50)] == [draw(seed) for seed in range(50)]
    assert len({draw(seed).faults for seed in range(50)}) > 40


def test_every_kind_is_drawn_within_its_bounds() -> None:
    faults = [
        (schedule.profile, fault) for seed in range(1000) for schedule in [draw(seed)] for fault in schedule.faults
    ]
    assert {fault.kind for _, fault in faults} == set(Kind) == set(DRAWS)
    for profile, fault in faults:
        low, high = DRAWS[fault.kind].size
        assert 0 <= fault.begin_ns <= HORIZON_NS[profile]
        assert low * 0.999 <= abs(fault.size) <= high * 1.001
        assert fault.where in DRAWS[fault.kind].where
        assert fault.kind is not Kind.CORRUPT_PAYLOAD or fault.where == "to_host" or profile.startswith("native")


def test_a_schedule_is_data_and_back() -> None:
    for seed in range(50):
        assert from_json(draw(seed).to_json()) == draw(seed)
    with pytest.raises(ValueError, match="no profile"):
        from_json('{"seed": 1, "profile": "nobody", "faults": []}')


def test_a_schedule_that_fails_is_shrunk_to_what_makes_it_fail() -> None:
    drop = Fault(Kind.DROP, 123_456_789, 80 * MS, 0.7321, "to_host")
    others = tuple(Fault(Kind.LATE_TICK, begin * MS, 0, 1e-3) for begin in (10, 50, 200))

    def fails(schedule: Schedule) -> bool:
        return any(fault.kind is Kind.DROP and fault.duration_ns >= 15 * MS for fault in schedule.faults)

    least = shrink(Schedule(1, "native", (others[0], drop, *others[1:])), fails)
    (fault,) = least.faults
    assert (fault.kind, fault.duration_ns, fault.begin_ns) == (Kind.DROP, 20 * MS, 120 * MS)
    assert fault.size < 1e-3


def test_what_does_not_fail_is_not_shrunk() -> None:
    with pytest.raises(ValueError, match="doesn't fail"):
        shrink(Schedule(1, "native", ()), lambda _: False)
