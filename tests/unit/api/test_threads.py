"""Work shared out over threads: in order, and never waiting for itself."""

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from hil_forceps.api.threads import over_threads

LONGEST_S = 20.0


@pytest.mark.parametrize("threads", [1, 2])
def test_tasks_that_share_out_work_of_their_own_end(threads: int) -> None:
    # A diagnosis that tried a slack at other widths hung for ever: all threads waited for their own tasks.
    pool = ThreadPoolExecutor(threads)
    mapper = over_threads(pool, threads)
    found: list[list[int]] = []

    def square(number: int) -> int:
        return number**2

    def sums(number: int) -> int:
        return sum(mapper(square, range(number)))

    worker = threading.Thread(target=lambda: found.append(list(mapper(sums, range(8)))), daemon=True)
    worker.start()
    worker.join(LONGEST_S)
    pool.shutdown(wait=False, cancel_futures=True)

    assert found == [[0, 0, 1, 5, 14, 30, 55, 91]]


def test_what_a_task_shares_out_is_done_by_idle_threads_too() -> None:
    """Two parts of one task meet: one thread alone would wait for the other part for ever."""
    met = threading.Barrier(2, timeout=LONGEST_S)
    with ThreadPoolExecutor(2) as pool:
        mapper = over_threads(pool, 2)
        assert [list(each) for each in mapper(lambda _: mapper(lambda _: met.wait() < 2, range(2)), [None])] == [
            [True, True]
        ]


def test_a_part_that_fails_fails_its_task() -> None:
    with ThreadPoolExecutor(2) as pool:
        mapper = over_threads(pool, 2)
        with pytest.raises(ZeroDivisionError):
            list(mapper(lambda _: list(mapper(lambda number: 1 // number, (1, 0, 1))), [None]))


def test_a_task_that_fails_leaves_its_thread_ready_to_share() -> None:
    with ThreadPoolExecutor(1) as pool:
        mapper = over_threads(pool, 1)
        with pytest.raises(ZeroDivisionError):
            list(mapper(lambda number: 1 // number, [0]))
        threads = set(mapper(lambda _: threading.current_thread().name, range(3)))

    assert threads != {threading.current_thread().name}
