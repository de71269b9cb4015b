"""The simulated drive in real time: a process on a CAN interface or a pseudo terminal."""
