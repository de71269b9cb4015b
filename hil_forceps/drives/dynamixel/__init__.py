"""A Dynamixel servo of the X series over protocol 2.0."""
