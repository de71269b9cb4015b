"""How a run ended: `run.json`, and lines on the terminal."""

import json
import sys
from collections.abc import Sequence
from typing import Any

from hil_forceps.bench.session import Plan, SessionResult
from hil_forceps.cli.terminal.fault_lines import fault_lines, told_reason
from hil_forceps.cli.terminal.gate_words import gate_data, gate_lines, since_start_s
from hil_forceps.cli.terminal.notes import note
from hil_forceps.drives.line_use import LineUse
from hil_forceps.rig.sections import BenchSettings

EXIT_RUN_FAILED = 2


def line_share(use: LineUse, results: Sequence[SessionResult], bench: BenchSettings) -> float:
    """Return an upper bound of the bus load: the share of the run's time for which frames were on the bus."""
    period = results[0].service.timing["period"]
    lasted_s = (period["mean_us"] or 0.0) * 1e-6 * period["count"]
    return use.time_s(bench.bitrate_bit_per_s, bench.data_bitrate_bit_per_s) / lasted_s if lasted_s > 0.0 else 0.0


def tell(session: SessionResult, plan: Plan, share_of_line: float | None) -> int:
    """Write `run.json` beside the recording, and the outcome to the terminal; return the exit code."""
    result, folder = session.service, plan.recording.parent
    content: dict[str, Any] = {
        "reason": result.reason.value,
        "message": result.message,
        "drive_disabled": result.drive_disabled,
        "recording": session.recording._asdict(),
        "bus_log": session.bus_log._asdict(),
        "counters": {name: dict(values) for name, values in result.counters.items()},
        "timing": dict(result.timing),
        "stages_s": {stage: since_start_s(result, time_ns) for time_ns, stage in result.stages},
        "gate": gate_data(result),
    }
    if session.fault is not None:
        content["fault"] = {**told_reason(session.fault.reason), "file": session.fault.path.name}
    if share_of_line is not None:
        content["bus_share_at_most"] = round(share_of_line, 4)
    failures = list(session.failures)
    try:
        (folder / "run.json").write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    except OSError as error:
        failures.append(f"{folder}/run.json: can't be written: {error.strerror}")
    said = f"{plan.name}: " if plan.name else ""
    for failure in failures:
        sys.stderr.write(f"hil-forceps: {said}{failure}\n")
    for line in gate_lines(result):
        note(f"{said}{line}")
    if not result.ok:
        lines = [result.message] if session.fault is None else fault_lines(session.fault, result.message, folder)
        sys.stderr.write(f"hil-forceps: {said}" + "\n".join(lines) + "\n")
        return EXIT_RUN_FAILED
    age = result.timing["age"]
    sys.stdout.write(
        f"{said}{result.message}; {result.counters['service']['references_sent']} references sent, sample to reference "
        f"p50 {age['p50_us']} µs, p99 {age['p99_us']} µs, max {age['max_us']} µs; results are in {folder}/\n"
    )
    return EXIT_RUN_FAILED if failures else 0
