"""Options of external references: the address to listen on, and the token of the senders."""

import math
import os
import secrets
import stat
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from hil_forceps.bridge.teleoperation.reference_input import ReferenceInput
from hil_forceps.bridge.teleoperation.udp_server import UdpReferences
from hil_forceps.control.gate.bounds import feedback_bounds
from hil_forceps.live.access import is_loopback, parse_address
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError

MIN_TOKEN_BYTES: Final = 16
MAX_TOKEN_BYTES: Final = 4096
MAX_TIMEOUT_S: Final = 1.0


def open_references(rigs: Sequence[Rig], where: str, token_file: Path | None, timeout_s: float | None) -> UdpReferences:
    """Listen for references to each axis; UserError if the address is not allowed or an option is out of range."""
    address = parse_address(where, "--references")
    token = b"" if token_file is None else read_token(token_file)
    if not token and not is_loopback(address[0]):
        raise UserError(
            f"--references {where}: references from other computers require a token; create one and give it to both "
            "ends: (umask 077; head -c 32 /dev/urandom | base64 > token), --references-token token"
        )
    if timeout_s is not None and not (math.isfinite(timeout_s) and 0.0 < timeout_s <= MAX_TIMEOUT_S):
        raise UserError(f"--references-timeout {timeout_s}: must be above 0 s and at most {MAX_TIMEOUT_S:g} s")
    session = 1 + secrets.randbelow((1 << 64) - 1)
    inputs = [
        ReferenceInput(session, round((feedback_bounds(rig).hold_s if timeout_s is None else timeout_s) * 1e9))
        for rig in rigs
    ]
    return UdpReferences(inputs, [rig.plant() for rig in rigs], address, token)


def read_token(path: Path) -> bytes:
    """Return the token in a file, stripped; UserError if other users can read the file, or the length is wrong."""
    try:
        with path.open("rb") as file:
            mode = os.fstat(file.fileno()).st_mode
            token = file.read(MAX_TOKEN_BYTES + 1).strip()
    except OSError as error:
        raise UserError(f"--references-token {path}: can't be read: {error.strerror}") from error
    if mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise UserError(f"--references-token {path}: other users can read the file; chmod 600 {path}")
    if not MIN_TOKEN_BYTES <= len(token) <= MAX_TOKEN_BYTES:
        raise UserError(
            f"--references-token {path}: the token must have {MIN_TOKEN_BYTES} to {MAX_TOKEN_BYTES} bytes; create "
            "another"
        )
    return token
