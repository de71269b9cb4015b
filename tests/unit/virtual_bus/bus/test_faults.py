"""Fault schedules: what they accept, and what they do to frames."""

from pathlib import Path

import pytest

from firmware_protocol.frames import Frame
from hil_forceps.rig.errors import UserError
from virtual_bus.bus.faults import FaultInjector, FaultKind, Side, load_faults, parse_faults

FEEDBACK, SETPOINT = Frame(0x081, b"\x01\x02\x03"), Frame(0x041, b"\x0a\x0b\x0c")
MS = 1_000_000


def injector(*entries: dict[str, object], seed: int = 1) -> FaultInjector:
    return FaultInjector(parse_faults(list(entries)), seed)


def deliver(what: FaultInjector, count: int, sender: Side = Side.DRIVE) -> list[tuple[int, int]]:
    """Route numbered frames 1 ms apart; return (due time, number) of what comes out."""
    out = []
    for k in range(count):
        routed = what.route(Frame(0x081, bytes([k])), sender, k * MS)
        out += [(due_ns, frame.data[0]) for due_ns, frame in routed]
    return out


def numbers(routed: list[tuple[int, int]]) -> list[int]:
    return [number for _, number in routed]


def test_without_faults_everything_passes_at_once() -> None:
    assert deliver(injector(), 3) == [(0, 0), (MS, 1), (2 * MS, 2)]


def test_drop_in_a_window_half_open() -> None:
    assert numbers(deliver(injector({"fault": "drop", "from_s": 0.002, "to_s": 0.004}), 6)) == [0, 1, 4, 5]


def test_count_limits() -> None:
    assert numbers(deliver(injector({"fault": "drop", "count": 2}), 5)) == [2, 3, 4]


def test_duplicate() -> None:
    assert numbers(deliver(injector({"fault": "duplicate", "from_s": 0.001, "to_s": 0.002}), 3)) == [0, 1, 1, 2]


def test_delay_holds_back_what_follows() -> None:
    late = deliver(injector({"fault": "delay", "delay_s": 0.0025, "count": 1}), 5)
    assert late == [(2_500_000, 0), (2_500_000, 1), (2_500_000, 2), (3 * MS, 3), (4 * MS, 4)]


def test_reorder_lets_one_frame_pass() -> None:
    assert deliver(injector({"fault": "reorder", "count": 1, "from_s": 0.001}), 4) == [
        (0, 0),
        (2 * MS, 2),
        (2 * MS, 1),
        (3 * MS, 3),
    ]


def test_corrupt_payload_flips_as_many_bits_as_asked() -> None:
    ((_, frame),) = injector({"fault": "corrupt_payload", "bits": 3}).route(FEEDBACK, Side.DRIVE, 0)
    flipped = int.from_bytes(frame.data, "little") ^ int.from_bytes(FEEDBACK.data, "little")
    assert flipped.bit_count() == 3
    assert frame.arbitration_id == FEEDBACK.arbitration_id


def test_corrupt_payload_of_an_empty_frame_changes_nothing() -> None:
    assert injector({"fault": "corrupt_payload", "bits": 3}).route(Frame(1, b""), Side.HOST, 5) == [(5, Frame(1, b""))]


@pytest.mark.parametrize(
    ("match", "hit"),
    [
        ({"function": "FEEDBACK"}, FEEDBACK),
        ({"function": 4}, FEEDBACK),
        ({"id": 0x041}, SETPOINT),
        ({"direction": "to_drive"}, SETPOINT),
        ({"direction": "to_host"}, FEEDBACK),
    ],
)
def test_matching(match: dict[str, object], hit: Frame) -> None:
    what = injector({"fault": "drop", **match})
    assert (what.route(SETPOINT, Side.HOST, 0) == []) is (hit is SETPOINT)
    assert (what.route(FEEDBACK, Side.DRIVE, 0) == []) is (hit is FEEDBACK)
    assert what.counters[FaultKind.DROP] == 1


def test_an_extended_id_is_matched_as_one_and_is_no_function() -> None:
    extended = FEEDBACK._replace(is_extended=True)
    what = injector({"fault": "drop", "id": 0x081, "extended": True})
    assert what.route(extended, Side.DRIVE, 0) == []
    assert what.route(FEEDBACK, Side.DRIVE, 0) == [(0, FEEDBACK)]
    for match in ({"function": "FEEDBACK"}, {"id": 0x081}):
        what = injector({"fault": "drop", **match})
        assert what.route(extended, Side.DRIVE, 0) == [(0, extended)]
        assert what.route(FEEDBACK, Side.DRIVE, 0) == []
    with pytest.raises(UserError, match=r"extended: goes with an id"):
        parse_faults([{"fault": "drop", "extended": True}])
    with pytest.raises(UserError, match=r"extended: must be true or false"):
        parse_faults([{"fault": "drop", "id": 5, "extended": 1}])
    with pytest.raises(UserError, match=r"id: must be a whole number from 0 to 2047"):
        parse_faults([{"fault": "drop", "id": 0x8001}])


def test_probability_is_seeded_and_about_right() -> None:
    entry: dict[str, object] = {"fault": "drop", "probability": 0.25}
    first, again, other = (numbers(deliver(injector(entry, seed=s), 250)) for s in (1, 1, 2))
    assert first == again != other
    assert 0.6 < len(first) / 250 < 0.9


def test_faults_do_not_disturb_each_others_chance() -> None:
    entry: dict[str, object] = {"fault": "drop", "probability": 0.25}
    alone = numbers(deliver(injector(entry), 100))
    beside = numbers(deliver(injector(entry, {"fault": "drop", "direction": "to_drive", "probability": 0.5}), 100))
    assert alone == beside


def test_state_changes_are_in_order_and_end_where_they_end() -> None:
    changes = injector(
        {"fault": "bus_gone", "from_s": 3.0}, {"fault": "bus_off", "node": "drive", "from_s": 1.0, "to_s": 2.0}
    ).state_changes
    assert [(c.kind.value, c.begins, c.time_ns // MS) for c in changes] == [
        ("bus_off", True, 1000),
        ("bus_off", False, 2000),
        ("bus_gone", True, 3000),
    ]


def test_every_problem_is_told_at_once() -> None:
    entries: list[object] = [
        {"fault": "explode"},
        {"fault": "drop", "probability": 1.5, "form_s": 1.0},
        {"fault": "delay"},
        {"fault": "bus_off"},
        {"fault": "drop", "from_s": 2.0, "to_s": 1.0},
        {"fault": "drop", "function": "FEEDBAK"},
        {"fault": "drop", "count": True},
        "drop",
        {"fault": "drop", "from_s": float("nan")},
    ]
    with pytest.raises(UserError) as caught:
        parse_faults(entries, "f.yaml")
    text = "\n".join(caught.value.problems)
    for index in range(len(entries)):
        assert f"f.yaml: [{index}]" in text
    assert "form_s" in text
    assert len(caught.value.problems) == 10


@pytest.mark.parametrize("nonsense", ["drop", {"fault": "drop"}, 3])
def test_a_schedule_is_a_list(nonsense: object) -> None:
    with pytest.raises(UserError, match="list of faults"):
        parse_faults(nonsense)


def test_fault_file(tmp_path: Path) -> None:
    path = tmp_path / "faults.yaml"
    path.write_text("- {fault: drop, function: SETPOINT, from_s: 1e-3, count: 2}\n- fault: bus_gone\n  from_s: 2.5\n")
    drop, gone = load_faults(path)
    assert (drop.kind, drop.function, drop.from_ns, drop.count) == (FaultKind.DROP, 2, MS, 2)
    assert gone.from_ns == 2500 * MS


def test_fault_file_that_is_not_there_or_not_yaml(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="can't be read"):
        load_faults(tmp_path / "none.yaml")
    broken = tmp_path / "broken.yaml"
    broken.write_text("- {fault: drop, fault: drop}\n")
    with pytest.raises(UserError, match=r"broken\.yaml:1"):
        load_faults(broken)
