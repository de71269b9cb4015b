"""Every profile's simulated drive keeps what the profile promises; every promise has a drive that breaks it."""

import json
from collections.abc import Iterable
from pathlib import Path

import pytest

from firmware_protocol.conformance.suite import Verdict
from hil_forceps.bridge.drive_conformance.catalogue import PROMISES
from hil_forceps.bridge.drive_conformance.certificate import certificate
from hil_forceps.bridge.drive_conformance.registry import CHECKS
from hil_forceps.drives.registry import PROFILES, machine_for
from tests.conformance.makers import broken
from tests.conformance.makers.bench import CONFIGS, drive_of, rig_of, suite_for
from tests.conformance.makers.table import ROWS, Broken, Row

assert broken.__doc__  # imported for its rows


def written(profile: str) -> str:
    """Return the certificate of a whole drive over its own line."""
    rig = rig_of(profile)
    assert rig.motor_driver is not None
    path: Path = CONFIGS / f"{profile}.yaml"
    with suite_for(rig, {"rig": str(path), "simulation": 0}) as suite:
        suite.open()
        results = suite.run(PROMISES)
        suite.close()
        return json.dumps(certificate(suite, rig.motor_driver, "virtual", results))


@pytest.mark.parametrize("profile", sorted(PROFILES))
def test_a_whole_drive_keeps_its_promises(profile: str) -> None:
    told = json.loads(written(profile))["requirements"]
    wrong = {each["id"]: each["evidence"] for each in told if each["verdict"] not in {"pass", "not run"}}
    may_stay_open = {promise.name for promise in PROMISES.values() if promise.level == "SHOULD"}
    assert not {name for name in wrong if name not in may_stay_open}, wrong
    assert not [each["id"] for each in told if each["verdict"] == "fail"], wrong
    passed = [each["id"] for each in told if each["verdict"] == "pass"]
    assert len(passed) >= len(PROMISES) // 2
    assert {"DRV-010", "DRV-020", "DRV-030", "DRV-040", "DRV-050", "DRV-060", "DRV-070", "DRV-071"} <= set(passed)


# The noise is the world's, one and the same for all: one of them shows that it is seeded.
ONCE_MORE = [pytest.param(name, marks=() if name == "mit" else pytest.mark.long) for name in sorted(PROFILES)]


@pytest.mark.parametrize("profile", ONCE_MORE)
def test_the_certificate_is_the_same_each_time(profile: str) -> None:
    assert written(profile) == written(profile)


def judged(row: Row, numbers: Iterable[int]) -> tuple[set[int], dict[int, str]]:
    """Return which of these promises a broken drive fails, and the evidence for all that it doesn't pass."""
    rig = rig_of(row.profile)
    rig = rig.model_copy(update={"limits": rig.limits.model_copy(update=row.limits)})
    peer, machine = drive_of(rig), machine_for(rig)
    row.mutate(Broken(rig, peer, machine))
    with suite_for(rig, {"nodes": [peer]}, machine) as suite:
        suite.open()
        results = suite.run(numbers)
        suite.close()
        assert not suite.session.may_have_torque or suite.session.refusal
    wrong = {r.requirement.number: r.evidence for r in results if r.verdict in (Verdict.FAIL, Verdict.INCONCLUSIVE)}
    return {r.requirement.number for r in results if r.verdict is Verdict.FAIL}, wrong


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row.name}-{row.profile}")
def test_a_broken_drive_fails_where_it_is_broken(row: Row) -> None:
    # What falls together with another is seen along the whole suite only.
    failed, wrong = judged(row, row.fails if len(row.fails) == 1 else PROMISES)
    assert failed == set(row.fails), wrong


@pytest.mark.long
@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row.name}-{row.profile}")
def test_a_broken_drive_fails_where_it_is_broken_and_nowhere_else(row: Row) -> None:
    failed, wrong = judged(row, PROMISES)
    assert failed == set(row.fails), wrong


def test_every_promise_has_a_check_and_a_drive_that_breaks_it() -> None:
    assert set(CHECKS) == set(PROMISES)
    assert {number for row in ROWS for number in row.fails} == set(PROMISES)
