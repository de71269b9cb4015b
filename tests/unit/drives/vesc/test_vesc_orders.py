"""Orders to a VESC and what answers say of them: only those to requests from behind an order count."""

from hil_forceps.drives.vesc.references import TAKEN_ANSWERS_IN_A_ROW, References
from hil_forceps.drives.vesc.release import QUIET_ANSWERS_IN_A_ROW, REPEAT_NS, Release

MS = 1_000_000


def test_a_release_is_not_confirmed_by_answers_to_requests_from_before_it() -> None:
    release = Release()
    release.want()
    assert release.is_due(10 * MS)
    for _ in range(10):
        release.see(0.0, 9 * MS)
    assert not release.is_quiet
    for _ in range(QUIET_ANSWERS_IN_A_ROW):
        assert not release.is_quiet
        release.see(0.0, 10 * MS)
    assert release.is_quiet


def test_a_release_is_ordered_again_until_it_is_seen_and_where_current_comes_back() -> None:
    release = Release()
    release.want()
    due = [now for now in range(0, 200, 2) if release.is_due(now * MS)]
    assert due == list(range(0, 200, REPEAT_NS // MS))
    for _ in range(QUIET_ANSWERS_IN_A_ROW):
        release.see(0.0, 200 * MS)
    assert not release.is_due(300 * MS)
    release.see(0.015, 300 * MS)
    assert release.is_due(302 * MS)


def test_a_first_reference_is_not_taken_by_answers_to_requests_from_before_it() -> None:
    references = References(100 * MS)
    references.send(1000)
    references.tick(10 * MS)
    references.send(2000)
    references.tick(12 * MS)
    assert references.held_raw == 1000
    assert not any(references.see(False, 9 * MS) for _ in range(10))
    assert [references.see(False, 10 * MS) for _ in range(TAKEN_ANSWERS_IN_A_ROW)] == [False] * (
        TAKEN_ANSWERS_IN_A_ROW - 1
    ) + [True]


def test_references_starve_by_their_last_not_by_their_first() -> None:
    references = References(100 * MS)
    assert not references.have_starved(1000 * MS)
    for now in range(0, 500, 2):
        references.send(now)
        references.tick(now * MS)
        assert not references.have_starved(now * MS)
    assert not references.have_starved(598 * MS)
    assert references.have_starved(599 * MS)
