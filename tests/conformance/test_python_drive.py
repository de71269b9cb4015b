"""The Python drive, requirement by requirement, the way a user's own test class would do it."""

from firmware_protocol.conformance.case import DriveConformance
from firmware_protocol.conformance.port import Port
from tests.conformance.devices import NODE, Device, DirectDatagramPort, DirectPort, DirectSerialPort


class TestClassicDrive(DriveConformance):
    node = NODE
    allow_motion = True

    def open_port(self) -> Port:
        return DirectPort(Device())


class TestFdDrive(TestClassicDrive):
    def open_port(self) -> Port:
        return DirectPort(Device(fd=True))


class TestSerialDrive(TestClassicDrive):
    def open_port(self) -> Port:
        return DirectSerialPort(Device())


class TestDatagramDrive(TestClassicDrive):
    def open_port(self) -> Port:
        return DirectDatagramPort(Device())
