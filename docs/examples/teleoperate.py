"""Send jaw references to `hil-forceps run --references 47100` for ten seconds, and print what comes back.

Python alone, no package. A joystick or a planner goes where `wanted` is.
"""

import contextlib
import math
import socket
import struct
import sys
import time

REFERENCE = struct.Struct("<4sBBBBQqdII16s")  # docs/teleoperation.md
ESTIMATE = struct.Struct("<4sBBBBQqqdddIBBBB16s")
PERIOD_S = 0.01


def wanted(time_s: float) -> float:
    """Return the jaw's angle [rad]: up and down by 0.1 rad around 90 degrees."""
    return math.pi / 2 + 0.1 * math.sin(2.0 * math.pi * 0.5 * time_s)


link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
link.connect(("127.0.0.1", int(sys.argv[1])))
link.settimeout(PERIOD_S)
session, began = 0, time.monotonic()  # the first answer tells the session
for sequence in range(round(float(sys.argv[2] if len(sys.argv) > 2 else 10.0) / PERIOD_S)):
    now_s = time.monotonic() - began
    link.send(REFERENCE.pack(b"HFTR", 1, 1, 0, 0, session, round(now_s * 1e9), wanted(now_s), sequence, 0, bytes(16)))
    with contextlib.suppress(TimeoutError, ConnectionRefusedError):
        told = ESTIMATE.unpack(link.recv(1 << 11))
        session, theta_j, tau_w = told[5], told[8], told[9]
        if sequence % 20 == 0:
            print(f"{now_s:6.2f} s  θ_j {theta_j:+.4f} rad  τ_w {1e3 * tau_w:+.3f} mN m  stage {told[12]}")
    time.sleep(max(0.0, (sequence + 1) * PERIOD_S - (time.monotonic() - began)))
