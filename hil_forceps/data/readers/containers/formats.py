"""The containers among the formats of runs."""

from hil_forceps.data.readers.containers.contained import read_contained
from hil_forceps.data.readers.format import Format

HDF5 = Format(
    "HDF5",
    (".h5", ".hdf5", ".he5"),
    lambda request: read_contained("hdf5", "HDF5", request),
    magic=(b"\x89HDF\r\n\x1a\n", b"MATLAB 7.3 MAT-file"),
    is_table=True,
)
EXCEL = Format(
    "Excel",
    (".xlsx", ".xlsm"),
    lambda request: read_contained("excel", "Excel", request),
    magic=(b"PK\x03\x04",),
    looks_like=lambda head: b"[Content_Types].xml" in head or b"xl/" in head,
    is_table=True,
)
MF4 = Format(
    "MDF",
    (".mf4", ".mdf"),
    lambda request: read_contained("mf4", "MDF", request),
    magic=(b"MDF     ", b"UnFinMF "),
    is_table=True,
)
