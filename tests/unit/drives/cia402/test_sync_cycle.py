"""One SYNC for the drives of a bus: at most one is unanswered, each knows its own, none holds others up for long."""

from pathlib import Path

from hil_forceps.drives.cia402.machine import Cia402
from hil_forceps.drives.cia402.objects import entries
from hil_forceps.drives.cia402.sync_cycle import COUNTERS, SHARED_ANSWER_NS, SharedSync, SyncCycle
from hil_forceps.drives.profile import host_ids
from hil_forceps.drives.registry import machines_for
from hil_forceps.rig import load_rig

MS = 1_000_000
RIG = load_rig(Path(__file__).parents[4] / "configs" / "drives" / "cia402.yaml")


def pair() -> tuple[SyncCycle, SyncCycle]:
    shared = SharedSync()
    return SyncCycle(dict.fromkeys(COUNTERS, 0), shared), SyncCycle(dict.fromkeys(COUNTERS, 0), shared)


def tick(first: SyncCycle, second: SyncCycle, now_ns: int) -> int:
    """Return how many SYNCs go out in a tick."""
    return first.poll(now_ns) + second.poll(now_ns)


def answer(cycle: SyncCycle, counts: int) -> int | None:
    cycle.see_position(counts)
    latched = cycle.see_current()
    return None if latched is None else latched.stamp_ns


def test_one_sync_a_tick_serves_both() -> None:
    first, second = pair()
    assert tick(first, second, 0) == 1
    answer(first, 1)
    answer(second, 1)  # the second has joined in this tick, behind the SYNC
    for n in range(1, 10):
        assert tick(first, second, n * MS) == 1
        assert answer(first, n) == answer(second, n) == n * MS
    assert [cycle._counters["unpaired"] for cycle in (first, second)] == [0, 0]
    assert first._counters["syncs_sent"] == 10


def test_no_sync_before_both_have_answered_the_last() -> None:
    first, second = pair()
    tick(first, second, 0)
    tick(first, second, MS)  # the first of its answers is still to come
    answer(first, 0)
    assert tick(first, second, 2 * MS) == 1
    answer(second, 2)
    assert tick(first, second, 3 * MS) == 0
    assert answer(first, 2) == 2 * MS
    assert tick(first, second, 4 * MS) == 1


def test_who_does_not_answer_twice_is_not_waited_for_and_not_believed() -> None:
    first, second = pair()
    tick(first, second, 0)
    answer(first, 0)
    sent = [n for n in range(1, 300) if tick(first, second, n * MS) and answer(first, n) == n * MS]
    held = SHARED_ANSWER_NS // MS
    assert sent == [1, 1 + held, *range(1 + 2 * held, 300)]
    assert answer(second, 7) is None  # of which it is, nobody knows
    assert second._counters["unpaired"] == 2
    assert answer(first, 300) is None
    second.rest()  # it is set up anew
    assert tick(first, second, 300 * MS) == 1
    answer(first, 300)
    assert tick(first, second, 301 * MS) == 1
    assert answer(second, 301) == 301 * MS


def test_a_drive_alone_is_waited_for_each_time() -> None:
    cycle = SyncCycle(dict.fromkeys(COUNTERS, 0), SharedSync())
    sent = [n for n in range(200) if cycle.poll(n * MS)]
    assert sent == [0, 50, 100, 150]
    assert answer(cycle, 1) == 150 * MS


def test_each_drive_watches_a_host_of_its_own() -> None:
    """Else the references of one would keep the other's motor alive whose estimator has stalled."""
    machines = machines_for([RIG, RIG.with_changes({"motor_driver.node_id": 126})])
    hosts = [machine.config.host_node for machine in machines if isinstance(machine, Cia402)]
    assert hosts == [127, 125]
    for machine, host in zip(machines, hosts, strict=True):
        assert isinstance(machine, Cia402)
        (watched,) = [entry for entry in entries(machine.config) if entry.object_index == 0x1016]
        assert watched.value == host << 16 | 100


def test_ids_that_drives_have_are_not_the_hosts() -> None:
    assert host_ids(range(127, 119, -1), [5, 126], 3) == [127, 125, 124]
