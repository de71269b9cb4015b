"""`python -m hil_forceps.data.readers.containers.child KIND PATH`: reads a container for the process that started it.

Answers with a line of JSON (the tables, or why there is none); takes lines of JSON (which columns of which table) and
answers each with another line and the columns: a count and float64s, little endian. A library may go round
for ever on damaged bytes, or take all memory, or end its process: here that ends this process alone.
"""

import importlib
import json
import logging
import os
import resource
import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np

from hil_forceps.data.readers.containers.content import ContentError, Table

MAX_MEMORY_BYTES = 8 << 30  # of addresses: what libraries map counts, too
MAX_CPU_TIME_S = 60
MAX_CPU_TIME_S_PER_MB = 1
LIBRARIES = {"excel": ("openpyxl", "formats"), "hdf5": ("h5py", "formats"), "mf4": ("asammdf", "mdf")}  # and extras


def main(kind: str, path: Path) -> None:
    """Serve one file."""
    _limit(path)
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is no answer
    logging.disable(logging.CRITICAL)
    try:
        tables = _tables(kind, path)
        _tell(out, {"tables": [_told(table) for table in tables]})
        for line in sys.stdin:
            wanted = json.loads(line)
            columns = tables[wanted["table"]].get(wanted["positions"], wanted["base"])
            _tell(out, {"columns": len(columns)})
            for column in columns:
                data = np.ascontiguousarray(column, dtype="<f8")
                out.write(struct.pack("<q", len(data)))
                out.write(data.tobytes())
            out.flush()
    except ContentError as error:
        _tell(out, {"error": str(error)})
    except ImportError as error:
        library, extra = LIBRARIES[kind]
        _tell(out, {"missing": library, "extra": extra, "error": str(error)})
    except MemoryError:
        _tell(out, {"error": "not enough memory: the file is damaged or too large"})
    except Exception as error:
        first = (str(error).splitlines() or [""])[0][:150]
        _tell(out, {"error": f"damaged, or in another format ({type(error).__name__}: {first}); write it again"})


def _tables(kind: str, path: Path) -> list[Table]:
    found: list[Table] = importlib.import_module(f"hil_forceps.data.readers.containers.{kind}").tables(path)
    return found


def _limit(path: Path) -> None:
    seconds = MAX_CPU_TIME_S + MAX_CPU_TIME_S_PER_MB * (path.stat().st_size >> 20)
    resource.setrlimit(resource.RLIMIT_AS, (MAX_MEMORY_BYTES, MAX_MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _told(table: Table) -> dict[str, Any]:
    return {
        "label": table.label,
        "names": table.names,
        "units": table.units,
        "group": table.group,
        "first_row": table.first_row,
        "notes": table.notes,
    }


def _tell(out: Any, answer: dict[str, Any]) -> None:
    out.write(json.dumps(answer).encode() + b"\n")
    out.flush()


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
