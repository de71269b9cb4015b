"""The record of targets and its table: nothing that did not run looks as if it had."""

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from tests.targets.record import TARGETS, Part, State, TargetRecord, latency_figures, recorded
from tools.targets.target_table import BEGIN, END, main

CERTIFICATE = {
    "verdicts": {"pass": 2, "fail": 0, "inconclusive": 1, "not run": 1},
    "requirements": [
        {"id": "HFP-001", "verdict": "not run"},
        {"id": "HFP-020", "verdict": "pass"},
        {"id": "HFP-032", "verdict": "inconclusive"},
        {"id": "HFP-121", "verdict": "pass"},
    ],
}
LOOP: dict[str, Any] = {
    "algorithm": "kalman",
    "duration_s": 10.0,
    "rmse_N_m": 8.0e-6,
    "in_process_rmse_N_m": 7.5e-6,
    "latency_us": latency_figures([40.0, 60.0, 5_000.0]),
    "samples": 10_000,
    "setpoints": 10_000,
    "lost": 0,
}


@pytest.fixture(autouse=True)
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("HIL_FORCEPS_TARGETS_DIR", str(tmp_path))
    monkeypatch.delenv("HIL_FORCEPS_EXPECT_TARGETS", raising=False)
    return tmp_path


def run_all(besides: str = "") -> None:
    for target, (_, parts) in TARGETS.items():
        for part in parts if target != besides else ():
            with recorded(target, part) as record:
                if part is Part.CONFORMANCE:
                    record.certificate(CERTIFICATE)
                if part is Part.LOOP:
                    record.loop(LOOP)
                if part is Part.TORQUE_FREE:
                    record.torque_free({"times_ms": [20.0, 20.5, 99.0], "within_ms": 25.0, "virtual": True})


def test_all_ran(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    run_all()
    assert main(["--markdown", str(tmp_path / "matrix.md")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 1 + len(TARGETS)
    assert lines[5].split()[:10] == ["c-process-udp", "ran", "2", "0", "1", "1", "8.00", "7.50", "60", "4901.2"]
    assert lines[5].split()[10:12] == ["20.5", "99.0"]
    text = (tmp_path / "matrix.md").read_text()
    figures, matrix = (part.splitlines() for part in text.split("\n\n")[:2])
    assert len(figures) == 2 + sum(Part.CONFORMANCE in parts for _, parts in TARGETS.values())
    assert matrix[0].count("|") == matrix[2].count("|") == len(TARGETS) + 1
    assert matrix[2].startswith("| HFP-001 | – | –")
    assert matrix[4].startswith("| HFP-032 | ? | ?")


def test_times_to_no_torque_are_drawn_where_there_are_any(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="no target has times"):
        main(["--figure", str(tmp_path / "figure.png")])
    run_all()
    assert main(["--figure", str(tmp_path / "figure.png")]) == 0
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(ValueError, match="no times"):
        TargetRecord("c-process-udp", Part.TORQUE_FREE).torque_free({"times_ms": []})


def test_a_page_keeps_what_is_around_the_marks(tmp_path: Path) -> None:
    run_all()
    page = tmp_path / "page.md"
    page.write_text(f"# Before\n{BEGIN}old\n{END}after\n", encoding="utf-8")
    for _ in range(2):
        assert main(["--markdown", str(page)]) == 0
        text = page.read_text(encoding="utf-8")
        assert text.startswith(f"# Before\n{BEGIN}| target | state |")
        assert text.endswith(f"{END}after\n")
        assert "old" not in text
    page.write_text(f"{BEGIN}old\n", encoding="utf-8")
    with pytest.raises(SystemExit):
        main(["--markdown", str(page)])
    assert page.read_text(encoding="utf-8") == f"{BEGIN}old\n"


def test_what_was_not_run_is_missed(capsys: pytest.CaptureFixture[str]) -> None:
    run_all(besides="socketcan-slcan")
    assert main([]) == 1
    assert "socketcan-slcan: no outcome" in capsys.readouterr().out


def test_a_part_that_was_not_run_is_missed(capsys: pytest.CaptureFixture[str]) -> None:
    run_all(besides="unicorn-bxcan")
    with recorded("unicorn-bxcan", Part.CONFORMANCE) as record:
        record.certificate(CERTIFICATE)
    assert main([]) == 1
    assert "unicorn-bxcan: not run: loop" in capsys.readouterr().out


def test_one_failed_part_is_a_failed_target(root: Path) -> None:
    run_all(besides="c-process-pty")
    with pytest.raises(AssertionError), recorded("c-process-pty", Part.CONFORMANCE):
        raise AssertionError("HFP-121\nand more")
    with recorded("c-process-pty", Part.LOOP) as record:
        record.loop(LOOP)
    outcome = json.loads((root / "c-process-pty" / "outcome.json").read_text())
    assert (outcome["state"], outcome["reason"]) == ("failed", "HFP-121")
    assert main([]) == 1


def test_parts_that_end_at_once_are_all_kept(root: Path) -> None:
    for _ in range(20):
        records = [TargetRecord("c-process-pty", part) for part in (Part.CONFORMANCE, Part.LOOP)]
        with ThreadPoolExecutor(2) as pool:
            list(pool.map(lambda record: record.finish(State.RAN), records))
        outcome = json.loads((root / "c-process-pty" / "outcome.json").read_text())
        assert (set(outcome["parts"]), outcome["state"]) == ({"conformance", "loop"}, "ran")


def test_a_run_that_was_cut_off_has_failed(root: Path) -> None:
    TargetRecord("c-process-pty", Part.LOOP)
    assert json.loads((root / "c-process-pty" / "outcome.json").read_text())["state"] == "failed"


@pytest.mark.parametrize(("expected", "code"), [("", 0), ("c-process-pty", 0), ("all", 1), ("a qemu-mps2-uart b", 1)])
def test_not_available_is_told_and_fails_where_it_is_expected(
    expected: str, code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run_all(besides="qemu-mps2-uart")
    for part in (Part.CONFORMANCE, Part.LOOP):
        with pytest.raises(pytest.skip.Exception), recorded("qemu-mps2-uart", part) as record:
            record.not_available("no emulator")
    monkeypatch.setenv("HIL_FORCEPS_EXPECT_TARGETS", expected)
    assert main([]) == code
    assert "not available: no emulator" in capsys.readouterr().out
    if code:
        with pytest.raises(pytest.fail.Exception), recorded("qemu-mps2-uart", Part.LOOP) as record:
            record.not_available("no emulator")


def test_what_nobody_would_look_for_is_refused() -> None:
    with pytest.raises(ValueError, match="no such target"):
        TargetRecord("vax", Part.LOOP)
    record = TargetRecord("c-process-pty", Part.LOOP)
    with pytest.raises(ValueError, match="without lost"):
        record.loop({key: value for key, value in LOOP.items() if key != "lost"})
    with pytest.raises(ValueError, match="verdicts"):
        record.certificate({"requirements": []})
    with pytest.raises(ValueError, match="no latencies"):
        latency_figures([])


def test_latencies_are_all_in_the_histogram() -> None:
    figures = latency_figures([0.0, 9.9, 10.0, 150_000.0])
    assert figures["histogram"]["counts"][:2] == [2, 1]
    assert figures["histogram"]["counts"][-1] == 1
    assert sum(figures["histogram"]["counts"]) == figures["count"] == 4
