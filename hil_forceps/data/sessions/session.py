"""A session: one file of runs, of one instrument, with the rig that describes it."""

from pathlib import Path
from typing import NamedTuple

RIG_NAME = "rig.yaml"
TABLE_NAME = "sessions.csv"


class Session(NamedTuple):
    """One session as a folder or its table has it."""

    name: str  # its path below the folder, without a suffix; of a run's folder that folder's
    path: Path
    instrument: str
    rig: Path
    told_date: str = ""  # as the table says it
