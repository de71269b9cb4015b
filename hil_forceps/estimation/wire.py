"""Resolution of `firmware_protocol`: angles 2⁻²⁴ turn, currents 0.2 mA."""

import math

WIRE_ANGLE_RAD = 2.0 * math.pi / 2**24
WIRE_CURRENT_A = 2.0e-4
