"""What a servo is asked and told before it may have torque, one request at a time.

Its torque is taken off first, and the bus watchdog cleared. Entries that are kept without power are written only where
they differ. The goal current is 0 at the end, so that switching torque on moves nothing.
"""

from collections import deque
from typing import Final, Literal, NamedTuple

from firmware_protocol.frames import Frame
from hil_forceps.drives.dynamixel import control_table as table
from hil_forceps.drives.dynamixel import packets as wire
from hil_forceps.drives.dynamixel.control_table import Item

PING_SIZE: Final = 3  # model number, firmware


class Step(NamedTuple):
    """One entry.

    write: now. tell: the same, unanswered. ensure: only where it differs. expect, at_least: it must be so, or `remedy`.
    """

    kind: Literal["write", "tell", "ensure", "expect", "at_least"]
    item: Item
    value: int
    remedy: str = ""


class SetUp:
    """The dialogue. `request` is what to send next, None at the end; `answer` takes what came back to it.

    `refusal` says in one line why a servo can't be used. `model` is known after the first answer.
    """

    def __init__(self, servo_id: int, current_limit_A: float, watchdog: int) -> None:
        self.refusal = ""
        self.model: table.Model | None = None
        self._servo_id = servo_id
        self._current_limit_A = current_limit_A
        self._watchdog = watchdog
        self._steps: deque[Step] = deque()

    def request(self) -> tuple[Frame, int | None] | None:
        """Return the next packet, and how many bytes its answer has; None: it has none."""
        if self.model is None:
            return wire.ping(self._servo_id), PING_SIZE
        if not self._steps:
            return None
        step = self._steps[0]
        item, data = step.item, _packed(step.item, step.value)
        if step.kind == "tell":
            return wire.write_unanswered(self._servo_id, item.address, data), None
        if step.kind == "write":
            return wire.write(self._servo_id, item.address, data), 0
        return wire.read(self._servo_id, item.address, item.size), item.size

    def told(self) -> None:
        """Go on behind a request that isn't answered."""
        self._steps.popleft()

    def subject(self) -> str:
        """Return what the request is about."""
        return str(self._steps[0].item) if self._steps else "ping"

    def answer(self, status: wire.Status) -> None:
        """Take the answer to the request."""
        if self.model is None:
            self._meet(status)
            return
        step = self._steps.popleft()
        if status.error:
            self._refuse(f"refuses {step.item}: {wire.error_words(status.error)}")
        elif step.kind != "write":
            self._compare(step, status.data)

    def _meet(self, status: wire.Status) -> None:
        number, firmware = int.from_bytes(status.data[:2], "little"), status.data[2] if len(status.data) > 2 else 0
        model = table.MODELS.get(number)
        if status.error:
            self._refuse(f"answers a ping with {wire.error_words(status.error)}")
        elif model is None:
            known = ", ".join(f"{each.name} ({each.number})" for each in table.MODELS.values())
            self._refuse(f"has the unknown model number {number}; known models: {known}")
        elif firmware < table.MIN_FIRMWARE:
            self._refuse(
                f"has the firmware {firmware}, which has no bus watchdog; update it to {table.MIN_FIRMWARE} or later "
                "with DYNAMIXEL Wizard"
            )
        else:
            self.model = model
            self._steps = deque(self._entries(model, firmware))

    def _entries(self, model: table.Model, firmware: int) -> list[Step]:
        limit = round(self._current_limit_A / model.current_unit_A)
        mapping = int.from_bytes(table.MAPPING, "little")
        startup = [Step("ensure", table.STARTUP_CONFIGURATION, 0)] if firmware >= table.MIN_STARTUP_FIRMWARE else []
        return [
            Step("tell", table.STATUS_RETURN_LEVEL, table.STATUS_OF_ALL),  # before, it may answer nothing but pings
            Step("write", table.TORQUE_ENABLE, 0),
            Step("write", table.BUS_WATCHDOG, 0),
            Step("ensure", table.RETURN_DELAY_TIME, 0),
            Step("ensure", table.DRIVE_MODE, 0),  # above all: no torque by a goal alone (bit 3)
            Step("ensure", table.OPERATING_MODE, table.CURRENT_BASED_POSITION),
            *startup,  # no torque, and no RAM of before, at power on
            Step(
                "expect",
                table.HOMING_OFFSET,
                0,
                # https://github.com/ROBOTIS-GIT/DynamixelSDK/issues/584
                "with another one, firmware moves the servo when its bus watchdog trips; set it to 0, and "
                "motor_driver.encoder_zero_rev instead",
            ),
            Step(
                "at_least",
                table.CURRENT_LIMIT,
                limit,
                f"motor_driver.current_limit_A ({self._current_limit_A:g} A) is this number of units of "
                f"{model.current_unit_A * 1e3:g} mA; raise the one or lower the other",
            ),
            Step("write", table.PROFILE_ACCELERATION, 0),  # the reference is followed as it is
            Step("write", table.PROFILE_VELOCITY, 0),
            Step("write", table.GOAL_CURRENT, 0),
            Step("write", table.INDIRECT_ADDRESSES, mapping),
            Step("write", table.BUS_WATCHDOG, self._watchdog),
        ]

    def _compare(self, step: Step, data: bytes) -> None:
        signed = step.kind == "expect"
        value = int.from_bytes(data, "little", signed=signed)
        is_so = value >= step.value if step.kind == "at_least" else value == step.value
        if is_so:
            return
        if step.kind == "ensure":
            self._steps.appendleft(step._replace(kind="write"))
        else:
            least = "at least " if step.kind == "at_least" else ""
            self._refuse(f"has {step.item} {value}, but {least}{step.value} is required: {step.remedy}")

    def _refuse(self, words: str) -> None:
        self.refusal = f"servo {self._servo_id} {words}"


def _packed(item: Item, value: int) -> bytes:
    return value.to_bytes(item.size, "little")
