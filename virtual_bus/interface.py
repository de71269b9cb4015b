"""The simulated world as a python-can interface, `virtual_forceps`, in virtual time.

    bus = can.Bus(interface="virtual_forceps", channel="bench", rig="configs/paper.yaml", simulation=2, seed=1)

Time stands still but for a handle that waits: `recv` runs the world until a frame arrives or its timeout has passed in
virtual time, `advance_until_ns` until a given time. There are no threads; the same calls with the same seed give the
same frames at the same nanosecond. Handles with one channel name share one world, each as a node of its own that sees
the others' frames; whoever waits moves time for all. The first names the rig, the world ends with the last.
"""

import errno
from collections.abc import Iterable, Sequence
from pathlib import Path

import can
from can import CanInitializationError, CanOperationError, CanTimeoutError
from can.typechecking import AutoDetectedConfig, CanFilters

from firmware_protocol.frames import Frame
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError
from virtual_bus import worlds
from virtual_bus.bus.bit_timing import NS_PER_S, BitTiming, frame_bits
from virtual_bus.bus.faults import FOREVER_NS, Fault, load_faults, parse_faults
from virtual_bus.bus.host_node import DEFAULT_RECEIVE_FRAMES
from virtual_bus.bus.node import Node
from virtual_bus.bus.port import DEFAULT_QUEUE_FRAMES, PortState
from virtual_bus.plant.load import paper_load, piecewise_linear
from virtual_bus.truth_log import TruthLog

_LAST_NS = FOREVER_NS - 1
_STATES = {
    PortState.ERROR_ACTIVE: can.BusState.ACTIVE,
    PortState.ERROR_PASSIVE: can.BusState.PASSIVE,
    PortState.BUS_OFF: can.BusState.ERROR,
}


def _faults_of(faults: str | Path | Iterable[object] | None) -> tuple[Fault, ...]:
    if isinstance(faults, str | Path):
        return load_faults(faults)
    return parse_faults(faults)


def frame_of(message: can.Message) -> Frame:
    """Turn a python-can message into a frame; CanOperationError when it is none that this bus carries."""
    if message.is_remote_frame or message.is_error_frame:
        raise CanOperationError("this bus carries data frames only", errno.EINVAL)
    frame = Frame(message.arbitration_id, bytes(message.data), message.is_fd, message.is_extended_id)
    try:
        frame_bits(frame)
    except ValueError as error:
        raise CanOperationError(str(error), errno.EINVAL) from None
    return frame


class VirtualForcepsBus(can.BusABC):
    """A host's handle on a simulated forceps, its drive and the bus between them, in virtual time.

    `rig`: a rig or its file, or several, as a text separated by commas, each with a drive on the bus; needed for the
    first handle of a channel unless `nodes` are given. `simulation`: load of
    the paper's simulation 1 or 2, or 0 for none; `load`, points of time [s] and torque on the jaw [N m] with straight
    lines between them, goes before it. `fd`: CAN FD with bit-rate switch; by default what the rig says.
    `faults`: a fault file, or a list as in `virtual_bus.bus.faults`. `truth_duration_s`: how much truth to log.
    `transmit_queue`, `receive_queue`: frames; `bitrate`, `data_bitrate` in bit/s go before the rig's. Numbers may come
    as strings, as from a configuration file. CanInitializationError says what can't be opened, and why.
    """

    def __init__(
        self,
        channel: str = "bench",
        rig: Rig | str | Path | Sequence[Rig | Path] | None = None,
        simulation: int | str = 2,
        seed: int | str = 0,
        fd: bool | str | None = None,
        faults: str | Path | Sequence[object] | None = None,
        nodes: Sequence[Node] | None = None,
        truth_duration_s: float | str = 0.0,
        transmit_queue: int | str = DEFAULT_QUEUE_FRAMES,
        receive_queue: int | str = DEFAULT_RECEIVE_FRAMES,
        bitrate: int | str | None = None,
        data_bitrate: int | str | None = None,
        load: Sequence[tuple[float, float]] | None = None,
        can_filters: CanFilters | None = None,
        **unknown: object,
    ) -> None:
        if unknown:
            raise ValueError(f"virtual_forceps knows no option {', '.join(sorted(unknown))}")
        if rig is not None and nodes is not None:
            raise ValueError("give a rig or nodes, not both")
        is_first = rig is not None or nodes is not None
        if faults is not None and not is_first:
            raise ValueError("faults belong to the handle that says which rig is to be (rig=...)")
        queues = _positive("transmit_queue", transmit_queue), _positive("receive_queue", receive_queue)
        paper, number, is_fd, truth_s = int(simulation), int(seed), _flag(fd), float(truth_duration_s)
        points = None if load is None else tuple(load)

        def make() -> worlds.World:
            schedule = _faults_of(faults)
            if rig is None:
                timing = _timing(BitTiming(), bitrate, data_bitrate)
                return worlds.node_world(nodes or (), number, bool(is_fd), schedule, timing)
            loaded = worlds.as_rigs(rig)
            bench = loaded[0].bench
            rates = BitTiming(bench.bitrate_bit_per_s, bench.data_bitrate_bit_per_s)
            fd_mode = bench.transport == "fd" if is_fd is None else is_fd
            timing = _timing(rates, bitrate, data_bitrate)
            profile = paper_load(paper) if points is None else piecewise_linear(*_split(points))
            return worlds.drive_world(loaded, profile, number, fd_mode, schedule, timing, truth_s)

        self._channel = str(channel)
        recipe = (rig, nodes, paper, points, number, is_fd, faults)
        try:
            self._world = worlds.join(self._channel, recipe, make if is_first else None)
        except UserError as error:
            raise CanInitializationError(str(error)) from error
        except ValueError as error:
            raise CanInitializationError(f"virtual_forceps: {error}") from error
        self._simulation = self._world.simulation
        self._medium = self._simulation.medium
        self._lock, self._is_fd = self._world.lock, self._world.is_fd  # looked up for every frame
        self._node, self._port = self._world.add_host(*queues)
        self._is_delayed = self._node.is_delayed()
        self._can_protocol = can.CanProtocol.CAN_FD if self._world.is_fd else can.CanProtocol.CAN_20
        self.channel_info = f"virtual_forceps: {self._channel}"
        super().__init__(channel=self._channel, can_filters=can_filters)

    # -- fast path: plain frames, no can.Message ----------------------------------------------------------------------

    def now_ns(self) -> int:
        """Return virtual time."""
        return self._simulation.now_ns

    def advance_until_ns(self, time_ns: int) -> None:
        """Run the world until `time_ns`; nothing happens when that has passed."""
        with self._lock:
            self._simulation.advance_until(time_ns)

    def send_frame(self, frame: Frame) -> bool:
        """Hand over a frame now or not at all; False when the queue is full or there is no bus (`state` tells).

        ValueError when there is no such CAN frame, or FD is off.
        """
        if self._is_shutdown:
            self._check_open()
        if frame[2] and not self._is_fd:
            raise ValueError("CAN FD is off on this bus")
        with self._lock:
            now_ns = self._simulation.now_ns
            if not self._is_delayed:
                return self._medium.submit(self._port, frame, now_ns)
            self._medium.frame_ns(frame)
            if self._medium.refuses(self._port, self._node.on_the_way()):
                return False
            self._node.send(frame, now_ns)
            self._simulation.settle(self._port)
            return True

    def receive_frames(self) -> list[tuple[int, Frame]]:
        """Return what has arrived by now, oldest first, each with its virtual time in ns; never waits."""
        with self._lock:
            frames = self._node.take_all(self._simulation.now_ns)
        if self._filters is None:
            return frames
        return [(time_ns, frame) for time_ns, frame in frames if self._wants(frame)]

    def truth_log(self, place: int = 0) -> TruthLog:
        """Return what the world really did, logged where `truth_duration_s` asked for it; ValueError without drive.

        `place`: of the drive, where there are several.
        """
        if not self._world.drives:
            raise ValueError("this world has no simulated drive, so no truth")
        return self._world.drives[place].truth

    def counters(self) -> dict[str, int]:
        """Return what this handle's controller has counted, by name, and `overrun`: frames nobody took in time."""
        return {**self._port.counters(), "overrun": self._node.overrun}

    # -- python-can ---------------------------------------------------------------------------------------------------

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a message; with a timeout wait so long, in virtual time, for room in the queue.

        CanOperationError with ENOBUFS when the queue is full, ENETDOWN when bus-off, ENODEV when the bus is gone,
        EINVAL when this bus carries no such frame; CanTimeoutError when there is still no room after the timeout.
        """
        self._check_open()
        frame = frame_of(msg)
        if frame.is_fd and not self._world.is_fd:
            raise CanOperationError("CAN FD is off on this bus", errno.EINVAL)
        deadline_ns = self.now_ns() + round((timeout or 0.0) * NS_PER_S)
        while not self.send_frame(frame):
            if self._medium.gone:
                raise CanOperationError("the bus is gone", errno.ENODEV)
            if self._port.state == PortState.BUS_OFF:
                raise CanOperationError("bus-off", errno.ENETDOWN)
            with self._world.lock:
                stepped = self._simulation.now_ns < deadline_ns and self._simulation.step(deadline_ns)
            if not stepped and timeout:
                raise CanTimeoutError(f"no room in the transmit queue within {timeout} s", errno.ENOBUFS)
            if not stepped:
                raise CanOperationError("the transmit queue is full", errno.ENOBUFS)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return the next message, waiting up to `timeout` s of virtual time for it, or None.

        Overridden as a whole, filters included: the base class measures what is left of a timeout by the wall clock.
        CanOperationError when the bus is gone, or nothing is left that could ever arrive.
        """
        deadline_ns = _LAST_NS if timeout is None else self.now_ns() + round(timeout * NS_PER_S)
        while True:
            with self._world.lock:
                self._check_open()
                taken = self._node.take(self._simulation.now_ns)
                if taken is None and not self._wait(deadline_ns):
                    return None
            if taken is not None and (self._filters is None or self._wants(taken[1])):
                return self._message(*taken)

    def flush_tx_buffer(self) -> None:
        """Forget what is queued and not yet on the wire."""
        with self._world.lock:
            self._node.flush()
            self._medium.flush(self._port)
            self._simulation.settle(self._port)

    def shutdown(self) -> None:
        """Leave the bus; safe to call twice."""
        if self._is_shutdown:
            return
        super().shutdown()
        with self._world.lock:
            self._simulation.remove(self._port)
        worlds.leave(self._channel)

    @property
    def state(self) -> can.BusState:
        """ACTIVE, PASSIVE when error passive, ERROR when bus-off or gone."""
        return can.BusState.ERROR if self._medium.gone else _STATES[self._port.state]

    @state.setter
    def state(self, new_state: can.BusState) -> None:
        raise NotImplementedError("the state of this bus follows from what happens on it")

    @staticmethod
    def _detect_available_configs() -> Sequence[AutoDetectedConfig]:
        return [{"interface": "virtual_forceps", "channel": name} for name in worlds.channels()]

    def _wait(self, deadline_ns: int) -> bool:
        """Run the world to its next instant; False when the deadline has come."""
        simulation = self._simulation
        if simulation.now_ns >= deadline_ns:
            return False
        if self._medium.gone:
            # The wait costs its time all the same, or a loop around recv would never see the bus come back.
            if deadline_ns < _LAST_NS:
                simulation.advance_until(deadline_ns)
            raise CanOperationError("the bus is gone", errno.ENODEV)
        limit_ns = min(deadline_ns, self._node.next_received_ns())
        if not simulation.step(limit_ns):
            if limit_ns >= _LAST_NS:
                raise CanOperationError("nobody on this bus will ever send: recv would wait forever", errno.EDEADLK)
            simulation.advance_until(limit_ns)
        return True

    def _wants(self, frame: Frame) -> bool:
        return any(
            each.get("extended", frame.is_extended) == frame.is_extended
            and not (each["can_id"] ^ frame.arbitration_id) & each["can_mask"]
            for each in self._filters or ()
        )

    def _message(self, time_ns: int, frame: Frame) -> can.Message:
        return can.Message(
            timestamp=time_ns / NS_PER_S,
            arbitration_id=frame.arbitration_id,
            is_extended_id=frame.is_extended,
            data=frame.data,
            is_fd=frame.is_fd,
            bitrate_switch=frame.is_fd,
            channel=self._channel,
        )

    def _check_open(self) -> None:
        if self._is_shutdown:
            raise CanOperationError("this handle has been shut down", errno.EBADF)


def _split(points: Iterable[tuple[float, float]]) -> tuple[list[float], list[float]]:
    """Return times and torques of points."""
    pairs = list(points)
    return [time_s for time_s, _ in pairs], [torque for _, torque in pairs]


def _flag(value: bool | str | None) -> bool | None:
    if value is None or isinstance(value, bool):
        return value
    words = {"true": True, "1": True, "yes": True, "false": False, "0": False, "no": False}
    if (known := words.get(str(value).lower())) is None:
        raise ValueError(f"fd: true or false, not {value!r}")
    return known


def _timing(base: BitTiming, bitrate: int | str | None, data_bitrate: int | str | None) -> BitTiming:
    return BitTiming(
        base.bitrate_bit_per_s if bitrate is None else _positive("bitrate", bitrate),
        base.data_bitrate_bit_per_s if data_bitrate is None else _positive("data_bitrate", data_bitrate),
    )


def _positive(name: str, value: int | str) -> int:
    number = int(value)
    if number < 1:
        raise ValueError(f"{name}: must be 1 or more, not {number}")
    return number
