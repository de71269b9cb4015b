"""File names in the folder of a run."""

from hil_forceps.data.recording.format import FAULT_NAME, RECORDING_NAME

__all__ = ["BUS_LOGS", "RECORDING_NAME", "RUN_FILES"]

BUS_LOGS = ("bus.log", "bus.asc", "bus.blf")
RUN_FILES = (RECORDING_NAME, "run.json", FAULT_NAME, *BUS_LOGS)
