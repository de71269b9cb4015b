"""Bus logs as runs: candump, ASC and BLF of the same traffic give the same run, as the host would have recorded it."""

from pathlib import Path

import can
import numpy as np
import pytest

from firmware_protocol import codec
from firmware_protocol.frames import Frame
from firmware_protocol.messages import BenchSensor, DriveState, Feedback, Setpoint, Timing
from firmware_protocol.scales import ANGLE_LSB_RAD, BENCH_TORQUE_LSB_N_M, CURRENT_LSB_A, wrap_int32
from hil_forceps.data.readers.read_run import read_run
from hil_forceps.data.run import Run
from hil_forceps.rig.errors import UserError

COUNT = 400
ARMED = 5  # samples before the drive becomes operational
TURN = 1 << 24


def traffic(node: int = 1, fd: bool = False, first_us: int = 1_000_000) -> list[tuple[float, Frame]]:
    """Return frames of a drive that turns by a revolution every 100 samples, through the end of the wire's 32 bits."""
    frames = []
    for n in range(COUNT):
        time_s, sequence = n * 1e-3, n & 0xFF
        state = DriveState.OPERATIONAL if n >= ARMED else DriveState.ARMED
        angle = wrap_int32(126 * TURN + n * TURN // 100)
        if n:
            setpoint = Setpoint(node, wrap_int32(angle + 1000), sequence, (n - 1) & 0xFF)
            frames.append((time_s - 5e-4, codec.encode(setpoint, fd)))
        frames.append((time_s, codec.encode(Feedback(node, angle, 5 * n, sequence))))
        timing = Timing(node, (first_us + 1000 * n) & 0xFFFFFFFF, sequence, sequence, int(state), 0)
        frames.append((time_s + 1e-4, codec.encode(timing)))
        frames.append((time_s + 2e-4, codec.encode(BenchSensor(node, 7 * n, -11 * n, sequence))))
    return frames


def write(path: Path, frames: list[tuple[float, Frame]]) -> Path:
    with can.Logger(path) as log:
        for time_s, (identifier, data, is_fd, is_extended) in frames:
            log.on_message_received(
                can.Message(
                    timestamp=1e9 + time_s,
                    arbitration_id=identifier,
                    data=data,
                    is_extended_id=is_extended,
                    is_fd=is_fd,
                )
            )
    return path


def check(run: Run) -> None:
    rows = np.arange(ARMED, COUNT)
    assert len(run) == len(rows)
    np.testing.assert_allclose(run.columns["time_s"], (rows - ARMED) * 1e-3, atol=1e-12)
    angle = 126 * TURN + rows * TURN // 100
    np.testing.assert_allclose(run.columns["theta_m_rad"], angle * ANGLE_LSB_RAD, rtol=1e-12)
    np.testing.assert_allclose(run.columns["theta_m_ref_rad"], (angle + 1000) * ANGLE_LSB_RAD, rtol=1e-12)
    np.testing.assert_allclose(run.columns["current_A"], 5 * rows * CURRENT_LSB_A)
    np.testing.assert_allclose(run.columns["theta_j_rad"], 7 * rows * ANGLE_LSB_RAD)
    np.testing.assert_allclose(run.columns["tau_w_N_m"], -11 * rows * BENCH_TORQUE_LSB_N_M)


@pytest.mark.parametrize("suffix", ["log", "asc", "blf"])
def test_every_kind_of_log_gives_the_run(suffix: str, tmp_path: Path) -> None:
    (run,) = read_run(write(tmp_path / f"bus.{suffix}", traffic()))
    assert run.name == "bus"
    check(run)


@pytest.mark.parametrize("suffix", ["log", "asc", "blf"])
def test_the_same_numbers_with_29_bits_are_somebody_elses(suffix: str, tmp_path: Path) -> None:
    frames = traffic()
    foreign = [(time_s, frame._replace(data=bytes(len(frame.data)), is_extended=True)) for time_s, frame in frames]
    path = tmp_path / f"bus.{suffix}"
    (run,) = read_run(write(path, [each for pair in zip(frames, foreign, strict=True) for each in pair]))
    check(run)
    assert run.notes == read_run(write(tmp_path / f"alone.{suffix}", frames))[0].notes


def test_a_candump_without_its_suffix_is_told_by_its_lines(tmp_path: Path) -> None:
    (run,) = read_run(write(tmp_path / "a.log", traffic()).rename(tmp_path / "a.dump"))
    check(run)


def test_two_drives_and_a_restart_give_runs_of_their_own(tmp_path: Path) -> None:
    again = [(time_s + 1.0, frame) for time_s, frame in traffic(1, first_us=500)]
    frames = sorted([*traffic(1), *traffic(2), *again], key=lambda stamped: stamped[0])
    runs = read_run(write(tmp_path / "bus.log", frames))
    assert [run.name for run in runs] == ["bus-node1-1", "bus-node1-2", "bus-node2-3"]
    check(runs[0])
    check(runs[2])
    assert len(runs[1]) == pytest.approx(COUNT - ARMED, abs=2)


def test_what_is_missing_is_told(tmp_path: Path) -> None:
    frames = traffic()
    kept = [stamped for number, stamped in enumerate(frames) if not 400 <= number < 440]
    kept.insert(100, (0.1, Frame(0x7F0, b"abc")))
    (run,) = read_run(write(tmp_path / "bus.log", kept))
    assert run.notes[:2] == ("10 samples are missing in the log", "1 frames of the log are not of this protocol")
    assert any("1 gap in time, about 10 samples missing" in note for note in run.notes)


def test_logs_without_a_run_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no drive became operational"):
        read_run(write(tmp_path / "short.log", traffic()[: 3 * ARMED]))
    with pytest.raises(UserError, match="contains no frame of this protocol"):
        read_run(write(tmp_path / "foreign.log", [(0.0, Frame(0x7F0, b"abc"))]))
    path = tmp_path / "time.log"
    path.write_text(write(tmp_path / "good.log", traffic()).read_text().replace("(1000000000.1", "(999000000000.1"))
    with pytest.raises(UserError, match="is not plausible"):
        read_run(path)
