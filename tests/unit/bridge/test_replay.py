"""The same samples and tick times give the same references, byte for byte, or the first difference is named."""

import io
import random
from dataclasses import replace

import numpy as np
import pytest

from firmware_protocol.host.samples import RawSample
from firmware_protocol.messages import DriveState
from firmware_protocol.scales import ANGLE_LSB_RAD
from hil_forceps.bridge.pipeline import Pipeline
from hil_forceps.bridge.replay import replay
from hil_forceps.control.gate import Gate
from hil_forceps.data.recording.reader import Recording, parse_recording
from hil_forceps.data.recording.writer import Outcome, Recorder
from hil_forceps.estimation.interface import Estimate, Estimator, Sample, State
from hil_forceps.rig.plant import PlantParameters
from hil_forceps.rig.sections import Limits

PLANT = PlantParameters(2.0e-3, 1.4e-3, 3.18e-8, 6.85e-8, 1.16e-4, 4.62e-7, 4.62e-9, 2.6e4, 1.35e-2)
LIMITS = Limits(position_min_rad=-1.0, position_max_rad=3.0, speed_max_rad_per_s=1e4, acceleration_max_rad_per_s2=1e9)
MS = 1_000_000


def smoother(gain: float) -> Estimator:
    """Something with memory, so that a missing sample shows for ever."""

    def start(sample: Sample) -> State:
        return np.array([sample.motor_torque_N_m])

    def step(state: State, sample: Sample) -> State:
        return state + gain * (sample.motor_torque_N_m - state)

    return Estimator("smoother", start, step, lambda state: Estimate(float(state[0]), 1e-3 * float(state[0])))


def make(gain: float = 0.1) -> Pipeline:
    return Pipeline(smoother(gain), lambda t_s: 1.0 - 0.2 * max(t_s, 0.0), PLANT, Gate(LIMITS), True, 3e-3)


class Kept(io.BytesIO):
    kept = b""

    def close(self) -> None:
        self.kept = self.getvalue()
        super().close()


@pytest.fixture(scope="module")
def recording() -> Recording:
    """Jittery: samples are late, lost and bunched, some ticks see none, some stale ones; a time without estimate."""
    chance = random.Random(4)
    line, file = make(), Kept()
    recorder = Recorder(file, {"algorithm": "smoother"}, threaded=False)
    waiting: list[RawSample] = []
    for k in range(3000):
        now_ns = k * MS + chance.randrange(900_000)
        if chance.random() > 0.02:
            state = DriveState.OPERATIONAL if k > 40 else DriveState.ARMED
            current = chance.randrange(-900, 900)
            waiting.append(RawSample(k % 256, k * MS, round(0.7 / ANGLE_LSB_RAD) + k, current, state, 0, 0, now_ns))
        if chance.random() > 0.3:
            for raw in waiting:
                assert line.feed(raw)
                recorder.sample(raw, line.sample, line.estimate)
            waiting.clear()
        reference = line.reference(now_ns + 100)
        recorder.reference(reference, now_ns + 200, Outcome.NONE, 0)
    recorder.close({})
    assert line.counters["stale"] > 5
    assert line.counters["nothing_new"] > 100
    return parse_recording(file.kept, "jittery")


def test_a_replay_gives_the_same_references_byte_for_byte(recording: Recording) -> None:
    result = replay(recording, make())
    assert result.first_difference is None
    assert result.samples.tobytes() == recording.samples.tobytes()
    assert result.references.tobytes() == recording.references.tobytes()


def test_the_smallest_difference_is_found_and_named(recording: Recording) -> None:
    references = recording.references.copy()
    references["reference_raw"][1234] += 1
    result = replay(replace(recording, references=references), make())
    assert result.first_difference is not None
    assert result.first_difference[:4] == ("/reference", 1234, references["tick_ns"][1234], "reference_raw")
    assert "reference_raw was" in str(result.first_difference)


def test_one_bit_of_an_estimate_counts(recording: Recording) -> None:
    samples = recording.samples.copy()
    samples["tau_w_estimate_N_m"][77] = np.nextafter(samples["tau_w_estimate_N_m"][77], 1.0)
    difference = replay(replace(recording, samples=samples), make()).first_difference
    assert difference is not None
    assert (difference.topic, difference.row, difference.field) == ("/sample", 77, "tau_w_estimate_N_m")


def test_a_measured_value_that_was_changed_shows_in_the_references(recording: Recording) -> None:
    samples = recording.samples.copy()
    samples["current_raw"][500] += 40
    difference = replay(replace(recording, samples=samples), make()).first_difference
    assert difference is not None
    assert difference.time_ns == samples["received_ns"][500]


def test_another_algorithm_gives_its_own_estimates(recording: Recording) -> None:
    result = replay(recording, make(gain=0.5))
    assert result.first_difference is not None
    assert len(result.samples) == len(recording.samples)
    state = 0.0
    torque = recording.samples["motor_torque_N_m"]
    state = torque[0]
    for k in range(1, 20):
        state = state + 0.5 * (torque[k] - state)
    assert result.samples["tau_w_estimate_N_m"][19] == state


def test_a_recording_cut_off_replays_as_far_as_it_goes(recording: Recording) -> None:
    for samples, references in ((0, 0), (10, 10), (10, 0)):
        order = [1] * samples + [2] * references
        part = replace(
            recording,
            samples=recording.samples[:samples],
            references=recording.references[:references],
            order=np.array(order, dtype=np.uint8),
        )
        result = replay(part, make())
        assert (len(result.samples), len(result.references)) == (samples, references)
