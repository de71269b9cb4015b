"""Defects of the recorder, and of what makes a run the same each time."""

import os
import time
from typing import Any

import pytest

from hil_forceps.bridge.axis import Axis
from hil_forceps.data.recording.mcap_file import McapFile
from hil_forceps.data.recording.writer import Recorder
from tests.fault_campaign.defects.table import around, defect
from virtual_bus.bus.host_node import HostNode


@defect("recorded")
def what_the_disk_refused_is_not_counted(patch: pytest.MonkeyPatch) -> None:
    """Messages that didn't reach the file aren't counted as dropped."""

    def write(old: Any, recorder: Any, chunk: Any) -> None:
        old(recorder, chunk)
        recorder._unwritten = 0

    around(patch, Recorder, "_write", write)


@defect("recorded", "end")
def a_full_disk_goes_untold(patch: pytest.MonkeyPatch) -> None:
    """The recording stops without a word."""

    def fail(old: Any, recorder: Any, error: OSError) -> None:
        old(recorder, error)
        recorder.failure = ""

    around(patch, Recorder, "_fail", fail)


@defect("recorded")
def the_last_chunk_is_forgotten(patch: pytest.MonkeyPatch) -> None:
    """Closing doesn't write what is still in memory."""

    def hand_over(old: Any, recorder: Any, *timeout: float) -> None:
        if timeout:
            recorder._offset = 0
        else:
            old(recorder, *timeout)

    around(patch, Recorder, "_hand_over", hand_over)


@defect("recorded")
def only_samples_under_torque_are_recorded(patch: pytest.MonkeyPatch) -> None:
    """Samples without torque don't reach the recorder."""

    def receive(old: Any, axis: Any, received: Any) -> None:
        recorder = axis._recorder

        class Choosy:
            bench = recorder.bench

            def sample(self, raw: Any, *more: Any) -> None:
                if raw.state >= 2:
                    recorder.sample(raw, *more)

        axis._recorder = Choosy()
        try:
            old(axis, received)
        finally:
            axis._recorder = recorder

    around(patch, Axis, "receive", receive)


@defect("recorded")
def a_chunk_is_written_over(patch: pytest.MonkeyPatch) -> None:
    """Each chunk after the first begins where the last one did."""

    def chunk(old: Any, file: Any, chunk: Any) -> None:
        if getattr(file, "before", None) is not None:
            file._stream.seek(file.before)
            file.good_bytes = file.before
        file.before = file.good_bytes
        old(file, chunk)

    around(patch, McapFile, "chunk", chunk)


@defect("same bytes")
def the_file_has_the_date_in_it(patch: pytest.MonkeyPatch) -> None:
    """The recording says when it was made."""

    def metadata(old: Any, file: Any, name: str, values: Any) -> None:
        old(file, name, {**values, "made": str(time.time_ns())})

    around(patch, McapFile, "metadata", metadata)


@defect("same bytes", profiles=("native", "odrive", "vesc"))
def jitter_is_drawn_anew(patch: pytest.MonkeyPatch) -> None:
    """The adapter's jitter has no seed."""

    def due(_old: Any, node: HostNode, now_ns: int, not_before_ns: int) -> int:
        jitter_ns = int.from_bytes(os.urandom(2), "little") % max(node._jitter_ns, 1)
        return max(now_ns + node._latency_ns + jitter_ns, not_before_ns)

    around(patch, HostNode, "_due_ns", due)
