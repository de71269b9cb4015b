"""Which entries are worth a refit."""

from dataclasses import replace

import numpy as np

from hil_forceps.diagnosis.hypotheses.entries import Probe
from hil_forceps.diagnosis.look import Scan
from hil_forceps.diagnosis.score import Group, Scores
from hil_forceps.diagnosis.shortlist import LARGE_GAIN, LARGE_SHARE, aliases, shortlists, to_try, with_aliases

NAMES = ("current_offset", "cogging", "coulomb_asymmetry", "wire_slack")
GAINS = np.array([250.0, 230.0, 120.0, 110.0])


def scan_of(names: tuple[str, ...]) -> Scan:
    """Return a scan of these entries with those gains."""
    probes = tuple(Probe(name, {}, (), False) for name in names)
    groups = tuple(Group(k, k + 1, False) for k in range(len(names)))
    one, square = [np.ones(1) for _ in names], np.eye(len(names))
    scores = Scores(GAINS, one, np.ones(len(names), dtype=np.bool_), 18.0, square, np.ones(len(names)))
    return Scan(probes, groups, np.empty((0, len(names)), dtype=np.float32), scores)


def test_the_alias_of_the_best_is_refitted_however_little_its_look_gains() -> None:
    order = [0, 1, 2, 3]
    lists = shortlists(order, GAINS, np.full(4, 18.0), overlooked=False, widely=False)
    assert lists[0] == [0, 1]
    assert with_aliases(lists, order, scan_of(NAMES))[0] == [0, 1, 2]
    assert with_aliases(lists, order, scan_of(("cogging", "current_offset", *NAMES[2:])))[0] == [0, 1]
    assert with_aliases((), order, scan_of(NAMES)) == ()


def test_aliases_differ_by_nothing_else() -> None:
    assert aliases(("cogging", "electrical_lag"), ("actuation_delay", "cogging"))
    assert not aliases(("electrical_lag",), ("actuation_delay", "cogging"))
    assert not aliases(("cogging",), ("cogging",))


def test_of_much_gain_a_small_share_is_worth_a_refit() -> None:
    order, needed = [0, 1, 2, 3], np.full(4, 18.0)
    gains = LARGE_GAIN * np.array([1.01, 0.5, 1.1 * LARGE_SHARE, 0.9 * LARGE_SHARE])
    assert shortlists(order, gains, needed, overlooked=False, widely=True)[0] == [0, 1, 2]
    assert shortlists(order, 0.9 * gains, needed, overlooked=False, widely=True)[0] == [0]
    assert shortlists(order, gains, needed, overlooked=False, widely=False)[0] == [0]


def test_each_channel_that_may_be_skewed_is_tried_and_other_entries_once() -> None:
    names = ("channel_skew", "channel_skew", "wire_creep", "wire_creep")
    probes = tuple(
        Probe(name, {}, (amplitude,), False)
        for name, amplitude in zip(names, ("theta_m_s", "theta_j_s", "share", "share"), strict=True)
    )
    assert to_try(replace(scan_of(names), probes=probes)) == [0, 1, 2]
