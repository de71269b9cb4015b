"""The plausibility of the feedback: each check from both sides of its bound, and what must never trip one."""

import math
import random
from collections.abc import Callable

import pytest

from hil_forceps.control.gate.bounds import FeedbackBounds
from hil_forceps.control.gate.feedback import BLOCK_SAMPLES, Block, FeedbackMonitor, judge, tension_N, trip_of
from hil_forceps.control.gate.trip import WORDS, GateTrip
from hil_forceps.rig.plant import PlantParameters

MS = 1_000_000
# Numbers that floats carry exactly, so that a sample may lie on a bound.
PLANT = PlantParameters(0.25, 0.5, 0.125, 0.5, 0.5, 0.0625, 0.0, 1e4, 2.0)
BOUNDS = FeedbackBounds(
    plant=PLANT,
    jump_speed_rad_per_s=1000.0,
    jump_slack_rad=0.5,
    still_s=0.125,
    still_travel_rad=0.25,
    still_travel_alone_rad=2.0,
    strong_A=0.5,
    against_travel_rad=0.75,
    tension_max_N=16.0,
    current_max_A=4.0,
    hold_s=0.05,
)
QUIET = Block(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def up(value: float) -> float:
    return math.nextafter(value, math.inf)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize(
    ("block", "expected"),
    [
        (QUIET, None),
        (QUIET._replace(against_rad=0.75), None),
        (QUIET._replace(against_rad=up(0.75)), ("against_current", up(0.75), 0.75, "rad")),
        (QUIET._replace(current_A=2.0), None),
        (QUIET._replace(current_A=up(2.0)), ("tension", 8.0 * up(2.0), 16.0, "N")),
        (QUIET._replace(still_s=0.125, reference_travel_rad=2.0), None),
        (
            QUIET._replace(still_s=0.125, reference_travel_rad=up(2.0)),
            ("encoder_frozen", up(2.0), 2.0, "rad"),
        ),
        (QUIET._replace(still_s=math.nextafter(0.125, 0.0), reference_travel_rad=up(2.0)), None),
        (QUIET._replace(still_s=1.0, reference_travel_rad=0.25, current_change_A=9.0), None),
        (QUIET._replace(still_s=1.0, reference_travel_rad=up(0.25), current_change_A=0.5), None),
        (
            QUIET._replace(still_s=1.0, reference_travel_rad=up(0.25), current_change_A=up(0.5)),
            ("encoder_frozen", up(0.25), 0.25, "rad"),
        ),
        (QUIET._replace(still_s=1.0, reference_travel_rad=up(0.25), current_change_A=-9.0), None),
        (QUIET._replace(still_s=0.0, reference_travel_rad=up(0.25), current_change_A=9.0), None),
        (QUIET._replace(still_s=9.0, current_change_A=9.0), None),
    ],
)
def test_each_check_from_both_sides(block: Block, expected: tuple[str, float, float, str] | None, sign: float) -> None:
    mirrored = block._replace(
        current_A=sign * block.current_A,
        reference_travel_rad=sign * block.reference_travel_rad,
        current_change_A=sign * block.current_change_A,
    )
    assert judge(mirrored, BOUNDS) == expected


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_current_from_both_sides(sign: float) -> None:
    slack = BOUNDS._replace(tension_max_N=math.inf)
    assert judge(QUIET._replace(current_A=sign * 4.0), slack) is None
    assert judge(QUIET._replace(current_A=sign * up(4.0)), slack) == ("current", up(4.0), 4.0, "A")


def test_the_checks_come_in_their_order() -> None:
    all_of_them = Block(0.0, 0.0, 9.0, 1.0, 9.0, 9.0, 9.0)
    found = judge(all_of_them, BOUNDS)
    assert found is not None
    assert found[0] == "encoder_frozen"
    found = judge(all_of_them._replace(still_s=0.0), BOUNDS)
    assert found is not None
    assert found[0] == "against_current"
    found = judge(all_of_them._replace(still_s=0.0, against_rad=0.0), BOUNDS)
    assert found is not None
    assert found[0] == "current"


def test_tension_is_what_the_motors_balance_leaves() -> None:
    assert tension_N(QUIET._replace(current_A=1.0), PLANT) == 8.0  # K_t i / r_m
    assert tension_N(QUIET._replace(acceleration_rad_per_s2=2.0), PLANT) == -1.0  # I_m α / r_m
    assert tension_N(QUIET._replace(speed_rad_per_s=1.0), PLANT) == -2.25  # (D_m ω + τ_Fm) / r_m
    assert tension_N(QUIET._replace(speed_rad_per_s=-1.0), PLANT) == 2.25
    assert tension_N(QUIET, PLANT) == 0.0


def test_a_finding_in_words() -> None:
    trip = trip_of(("tension", 5.2, 5.0, "N"), 7)
    assert trip == GateTrip("tension", 5.2, 5.0, "N", 7)
    assert str(trip) == f"{WORDS['tension']}: 5.2 N, the limit is 5 N"
    assert str(GateTrip("encoder_frozen", 0.5123456, 0.5, "rad", 7)).startswith("encoder frozen or motor blocked: ")


class Feed:
    """A monitor with its time; remembers all blocks."""

    def __init__(self, bounds: FeedbackBounds = BOUNDS) -> None:
        self.monitor = FeedbackMonitor(bounds)
        self.now_ns = 1000 * MS
        self.monitor.restart(self.now_ns, 0.0)

    def see(self, theta: float, current: float = 0.0, reference: float = 0.0, wait_ns: int = MS) -> str | None:
        self.now_ns += wait_ns
        self.monitor.see(self.now_ns, theta, current, reference)
        return None if self.monitor.finding is None else self.monitor.finding[0]


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("wait_ns", [MS, 3 * MS])
def test_a_jump_is_what_goes_further_than_the_motor_gets(sign: float, wait_ns: int) -> None:
    furthest = 1000.0 * 1e-9 * wait_ns + 0.5
    feed = Feed()
    assert feed.see(sign * furthest, wait_ns=wait_ns) is None
    assert feed.see(0.0, wait_ns=wait_ns) is None
    assert feed.see(sign * up(furthest), wait_ns=wait_ns) == "encoder_jump"
    assert feed.monitor.finding == ("encoder_jump", up(furthest), furthest, "rad")
    feed.monitor.restart(feed.now_ns, 0.0)
    assert feed.monitor.finding is None


def test_an_angle_that_is_no_number_is_a_jump() -> None:
    assert Feed().see(math.nan) == "encoder_jump"
    assert Feed().see(math.inf) == "encoder_jump"


def test_it_says_when_it_has_decided() -> None:
    monitor = FeedbackMonitor(BOUNDS)
    monitor.restart(0, 0.0)
    assert [monitor.see(k * MS, 0.0, 0.0, 0.0) for k in range(1, 17)] == ([False] * 7 + [True]) * 2
    assert monitor.see(17 * MS, 9.0, 0.0, 0.0)
    assert BLOCK_SAMPLES == 8


@pytest.mark.parametrize("place", range(8))
@pytest.mark.parametrize("spike", [-1e3, 1e3])
def test_a_single_sample_trips_nothing(place: int, spike: float) -> None:
    feed = Feed()
    for tick in range(64):
        assert feed.see(0.0, current=spike if tick % 8 == place else 1.9) is None


@pytest.mark.parametrize(("current", "expected"), [(1.9, None), (2.0, None), (2.1, "tension"), (-2.1, "tension")])
def test_the_mean_current_of_a_block_counts(current: float, expected: str | None) -> None:
    feed = Feed()
    found = [feed.see(0.0, current=current + 0.5 * (-1) ** tick) for tick in range(16)]
    assert found == [None] * 7 + [expected] * 9


def test_speed_and_acceleration_are_those_of_blocks() -> None:
    """Motor alone: K_t i = I_m α + D_m ω + τ_Fm, so no tension is left although the current is far beyond it."""
    feed, theta, speed = Feed(BOUNDS._replace(tension_max_N=0.8, current_max_A=math.inf, strong_A=math.inf)), 0.0, 0.0
    for _ in range(400):
        theta += speed * 1e-3 + 0.5 * 16.0 * 1e-6
        speed += 16.0 * 1e-3
        current = (0.125 * 16.0 + 0.5 * speed + 0.0625) / 2.0
        # The first block has none before it: its acceleration is taken as zero, which is 2 N m off.
        found = feed.see(theta, current)
        if feed.now_ns >= 1016 * MS:
            assert found is None, feed.now_ns
        elif feed.now_ns == 1008 * MS:
            assert found == "tension"


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_acceleration_spans_the_middles_of_two_blocks_of_any_length(sign: float) -> None:
    monitor = FeedbackMonitor(BOUNDS._replace(tension_max_N=1e-9, strong_A=math.inf))
    monitor.restart(0, 0.0)
    for tick in range(1, 9):
        assert monitor.see(tick * MS, 0.0, 0.0, 0.0) is (tick == 8)
        assert found_by(monitor) is None
    for tick in range(1, 9):
        monitor.see((8 + 3 * tick) * MS, sign * 0.024 * tick / 8, 0.0, 0.0)
    # 1 rad/s after 0, the middles 4 + 12 ms apart: 62.5 rad/s²; (I_m α + D_m ω + τ_Fm) / r_m.
    expected = (0.125 * 62.5 + 0.5 + 0.0625) / 0.25
    assert found_by(monitor) == pytest.approx(expected)
    # From the second block to a third of 8 ms, at rest again: 12 + 4 ms.
    for tick in range(1, 9):
        monitor.see((32 + tick) * MS, sign * 0.024, 0.0, 0.0)
    assert found_by(monitor) == pytest.approx(0.125 * 62.5 / 0.25)


def found_by(monitor: FeedbackMonitor) -> float | None:
    return None if monitor.finding is None else monitor.finding[1]


def test_frozen_counts_from_the_block_in_which_the_angle_last_changed() -> None:
    wide = BOUNDS._replace(tension_max_N=math.inf)
    feed = Feed(wide)
    theta = 0.0
    for tick in range(24):  # moves, and the reference and the current far ahead of it
        theta = 1e-9 * tick
        assert feed.see(theta, current=3.0, reference=50.0) is None
    for _ in range(400):  # stands, and so do they: whatever they are
        assert feed.see(theta, current=3.0, reference=50.0) is None
    for _ in range(8):
        found = feed.see(theta, current=3.0, reference=52.5)
    assert found == "encoder_frozen"
    assert feed.monitor.finding == ("encoder_frozen", 2.5, 2.0, "rad")


@pytest.mark.parametrize(("pushed", "expected"), [(0.4, None), (0.6, "encoder_frozen"), (-0.6, None)])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_frozen_with_a_current_that_pushes(pushed: float, expected: str | None, sign: float) -> None:
    feed = Feed()
    for _ in range(8):
        feed.see(0.0, current=sign * 0.1, reference=sign * 5.0)
    for _ in range(160):
        found = feed.see(0.0, current=sign * (0.1 + pushed), reference=sign * 5.5)
    assert found == expected
    moved = feed.see(1e-12, current=sign * (0.1 + pushed), reference=sign * 5.5)
    for _ in range(7):
        moved = feed.see(1e-12, current=sign * (0.1 + pushed), reference=sign * 5.5)
    assert moved is None


def test_frozen_takes_its_time() -> None:
    feed = Feed()
    for tick in range(1, 400):
        if feed.see(0.0, reference=0.0 if tick <= 8 else 9.0) is not None:
            break
    assert tick * 1e-3 == pytest.approx(0.008 + 0.128)  # the first whole blocks that are 125 ms long


def against(feed: Feed, theta: float, step: float, current: float, ticks: int) -> tuple[float, str | None]:
    found = None
    for _ in range(ticks):
        theta += step
        found = feed.see(theta, current)
        if found is not None:
            break
    return theta, found


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize(
    ("current", "expected"), [(-0.6, "against_current"), (-0.4, None), (-0.5, None), (0.6, None), (0.0, None)]
)
def test_against_the_current_from_both_sides(current: float, expected: str | None, sign: float) -> None:
    feed = Feed(BOUNDS._replace(tension_max_N=math.inf))
    theta, found = against(feed, 0.0, sign * 0.03125, sign * current, 64)
    assert found == expected
    if expected is not None:
        assert abs(theta) == 1.0  # the first block behind 0.75
        assert feed.monitor.finding == ("against_current", 1.0, 0.75, "rad")


def test_against_the_current_counts_without_a_break() -> None:
    feed = Feed(BOUNDS._replace(tension_max_N=math.inf))
    theta = 0.0
    for _ in range(10):
        theta, found = against(feed, theta, 0.03125, -0.6, 24)
        assert found is None
        theta, found = against(feed, theta, 0.03125, 0.6, 8)
        assert found is None
    assert against(feed, theta, 0.03125, -0.6, 32)[1] == "against_current"
    feed.monitor.restart(feed.now_ns, 0.0)
    theta = 0.0
    for _ in range(10):  # standing still is a break, too
        theta, found = against(feed, theta, 0.03125, -0.6, 24)
        assert found is None
        theta, found = against(feed, theta, 0.0, -0.6, 8)
        assert found is None


def test_restarting_forgets_all() -> None:
    feed = Feed(BOUNDS._replace(tension_max_N=math.inf))
    theta, _ = against(feed, 0.0, 0.03125, -0.6, 27)
    feed.monitor.restart(feed.now_ns, theta)
    theta, found = against(feed, theta, 0.03125, -0.6, 24)
    assert found is None
    assert against(feed, theta, 0.03125, -0.6, 8)[1] == "against_current"
    feed.monitor.restart(feed.now_ns, 5.0)
    assert feed.see(5.25) is None
    feed.monitor.restart(feed.now_ns, 0.0)
    for _ in range(400):
        assert feed.see(0.0, current=0.45, reference=0.2) is None  # from where the motor was, with no current


def hunting(tick: int) -> tuple[float, float, float]:
    """A drive that goes back and forth over a count."""
    return 1e-3 * (tick // 3 % 2), 0.3 * (-1) ** tick, 0.0


def holding_a_load(tick: int) -> tuple[float, float, float]:
    """Not a bit moves while the load comes and goes."""
    return 0.0, 1.5 * math.sin(tick / 50.0), 0.0


def stiction(tick: int) -> tuple[float, float, float]:
    """The reference creeps, and the motor follows in steps of twenty counts, with the current that these take."""
    reference = 2e-4 * tick
    step = 2e-2 * (tick // 100)
    return step, 0.4 * (reference - step) / 2e-2, reference


def braking(tick: int) -> tuple[float, float, float]:
    """Out of full speed against full current, four times a second."""
    phase = tick % 250
    return 0.3 * (1.0 - math.cos(phase / 250 * 2.0 * math.pi)), -1.9 if phase < 50 else 0.0, 0.0


def noise(tick: int) -> tuple[float, float, float]:
    chance = random.Random(tick)
    return 0.1 * chance.random(), chance.uniform(-2.4, 2.4), 0.0


@pytest.mark.parametrize("motion", [hunting, holding_a_load, stiction, braking, noise])
def test_what_is_no_fault_trips_nothing(motion: Callable[[int], tuple[float, float, float]]) -> None:
    feed = Feed(BOUNDS._replace(tension_max_N=math.inf))
    for tick in range(2000):
        theta, current, reference = motion(tick)
        assert feed.see(theta, current, reference) is None, tick
