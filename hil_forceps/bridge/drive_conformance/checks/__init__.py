"""The checks; importing this package registers those of every file in it."""

from hil_forceps.bridge.drive_conformance.checks import listening, motion, stopping, whole

__all__ = ["listening", "motion", "stopping", "whole"]
