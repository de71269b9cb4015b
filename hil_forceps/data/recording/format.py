"""What a recording holds: three topics of messages of fixed length, described in the file itself.

MCAP with CDR messages under ros2msg schemas: Foxglove, `mcap cat` and the ROS 2 tools read them without us. CDR
aligns a number to its own size, so fields stand in order of falling size and a message is one packed little-endian
struct: 0.3 µs to write, exact to the last bit of every float (JSON costs ten times that and four times the room).

`/sample`     one per sample, after the estimator has taken it: raw integers of the wire, SI, the estimate.
`/reference`  one per tick while enabling and running, whether a reference left or not, and why.
`/bench`      what a bench knows and a real forceps doesn't: jaw angle and reaction torque.

Checksums: each chunk and each attachment has its own, the data section has one over all its bytes, the summary has one.
What a recording says of itself stands in a metadata record, which has none, and once more in an attachment, so that a
recording that was cut off can vouch for it.

Times: `stamp_ns` is the drive's clock, unwrapped; `log_time`, `received_ns`, `tick_ns`, `sent_ns` are the host's.
ROS wants lower case, so `current_A` is `current_a` in the file.
"""

import struct
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode

FORMAT_VERSION = 1
RECORDING_NAME = "run.mcap"  # in the folder of a run
METADATA_NAME = "hil_forceps"  # metadata record at the head: where the recording comes from
BEGUN_KEY = "begun_utc"  # of that record: when the run began, ISO 8601; not in virtual time
RESULT_NAME = "hil_forceps_result"  # metadata record at the end: how the run ended
SETTINGS_NAME = "hil_forceps.json"  # attachment at the head: the format's version, and the metadata once more
FAULT_NAME = "fault.json"  # attachment before the end: the last second before a fault
RECOVERY_NAME = "hil_forceps_recovery"  # metadata record of a recovered recording: what is missing, what was restored
JSON_TYPE = "application/json"
MESSAGE_ENCODING = "cdr"
SCHEMA_ENCODING = "ros2msg"
COMPRESSION = "zstd"
RECORD_HEAD = struct.Struct("<BQ")  # opcode, length of what follows
CDR_HEAD = b"\x00\x01\x00\x00"  # little-endian, no options
MESSAGE_HEAD = struct.Struct("<BQHIQQ4s")  # opcode, length, channel, sequence, log and publish time; CDR head
MESSAGE_START = struct.Struct("<BQHI")  # of these, as far as the sequence
_STRUCT_CODE = {"int64": "q", "float64": "d", "int32": "i", "uint8": "B"}


class Field(NamedTuple):
    """One number of a message; `note` becomes the comment in the schema."""

    type: str
    name: str
    note: str


class Topic(NamedTuple):
    """One kind of message: where it stands and what it is made of."""

    channel: int
    topic: str
    schema: str
    fields: tuple[Field, ...]

    @property
    def dtype(self) -> np.dtype[np.void]:
        """The message body as numpy sees it."""
        return np.dtype([(field.name, np.dtype(field.type).newbyteorder("<")) for field in self.fields])

    @property
    def record(self) -> struct.Struct:
        """The whole MCAP message record, from its opcode on."""
        return struct.Struct(MESSAGE_HEAD.format + "".join(_STRUCT_CODE[field.type] for field in self.fields))

    @property
    def length(self) -> int:
        """The length that the message record states: what follows its first nine bytes."""
        return self.record.size - RECORD_HEAD.size

    def schema_text(self) -> str:
        """Return the ros2msg definition."""
        return "".join(f"{field.type} {field.name.lower()}  # {field.note}\n" for field in self.fields)


SAMPLE = Topic(
    channel=1,
    topic="/sample",
    schema="hil_forceps/msg/Sample",
    fields=(
        Field("int64", "stamp_ns", "drive's clock: when it was measured, unwrapped"),
        Field("int64", "received_ns", "host's clock: when it arrived"),
        Field("int64", "theta_m_raw", "2**-24 of a revolution, unwrapped"),
        Field("float64", "theta_m_rad", "motor pulley angle"),
        Field("float64", "current_A", "motor current, held over the interval that ended at the stamp"),
        Field("float64", "motor_torque_N_m", "torque constant times current"),
        Field("float64", "tau_w_estimate_N_m", "reaction torque as estimated after this sample"),
        Field("float64", "elongation_estimate_m", "wire elongation as estimated after this sample"),
        Field("int32", "current_raw", "0.2 mA"),
        Field("uint8", "sequence", "of the sample"),
        Field("uint8", "setpoint_sequence", "of the last reference that the drive had accepted"),
        Field("uint8", "state", "0 disabled, 1 armed, 2 operational, 3 fault"),
        Field("uint8", "fault", "reason as in the protocol, 0 none"),
    ),
)

REFERENCE = Topic(
    channel=2,
    topic="/reference",
    schema="hil_forceps/msg/Reference",
    fields=(
        Field("int64", "tick_ns", "host's clock: the tick's own time, which the gate saw"),
        Field("int64", "sent_ns", "host's clock: when the frame was handed over; the tick's time when none was"),
        Field("int64", "stamp_ns", "drive's clock: the sample it was computed from"),
        Field("int64", "trajectory_ns", "time into the experiment; negative before it began"),
        Field("int64", "reference_raw", "what the gate let pass, 2**-24 of a revolution; 0 when nothing passed"),
        Field("float64", "theta_j_ref_rad", "jaw angle wanted"),
        Field("float64", "elongation_used_m", "wire elongation compensated for; 0 when uncompensated"),
        Field("float64", "requested_rad", "motor angle wanted: what the gate was asked for"),
        Field("float64", "passed_rad", "what the gate let pass; NaN when nothing"),
        Field("uint8", "verdict", "see the metadata `verdicts`"),
        Field("uint8", "outcome", "see the metadata `outcomes`"),
        Field("uint8", "sample_sequence", "of the sample it was computed from"),
        Field("uint8", "setpoint_sequence", "of the reference sent; that of the one before when none was"),
    ),
)

BENCH = Topic(
    channel=3,
    topic="/bench",
    schema="hil_forceps/msg/Bench",
    fields=(
        Field("int64", "received_ns", "host's clock: when it arrived"),
        Field("float64", "theta_j_rad", "jaw angle, measured"),
        Field("float64", "tau_w_N_m", "reaction torque on the jaw, measured"),
        Field("int32", "theta_j_raw", "2**-24 of a revolution"),
        Field("int32", "tau_w_raw", "0.1 uN m"),
        Field("uint8", "sequence", "of the sample taken at the same instant"),
    ),
)

TOPICS = (SAMPLE, REFERENCE, BENCH)
MESSAGE_OPCODE = int(Opcode.MESSAGE)
