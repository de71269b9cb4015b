"""Jaw references from outside while a run lasts, and estimates back: the bridge in a teleoperation system."""
