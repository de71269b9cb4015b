"""A CiA 402 drive over CANopen."""
