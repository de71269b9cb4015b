"""A cable between two serial ports: makes two pseudo terminals, says where, and carries bytes both ways until killed.

It stands between two CAN devices of the kernel (slcan), which can't be put on one pseudo terminal: there nobody would
read as a program does, and only that tells the writing device that it may send its next frame.
"""

import os
import select
import sys
import tty


def main() -> None:
    """Say `ready PORT PORT`, then carry."""
    (left, left_port), (right, right_port) = os.openpty(), os.openpty()
    for port in (left_port, right_port):
        tty.setraw(port)
    sys.stdout.write(f"ready {os.ttyname(left_port)} {os.ttyname(right_port)}\n")
    sys.stdout.flush()
    other = {left: right, right: left}
    while True:
        readable, _, _ = select.select([left, right], [], [])
        for end in readable:
            os.write(other[end], os.read(end, 4096))


if __name__ == "__main__":
    main()
