"""The compiler of the world's kernels."""

from hil_forceps.kernels.compiler import kernel_compiler, run_kernel_compiler, subroutine

__all__ = ["kernel", "run_kernel", "subroutine"]

_SOURCES = (
    "virtual_bus/plant",
    "virtual_bus/effects",
    "virtual_bus/logs.py",
    "virtual_bus/bus",
    "firmware_protocol/scales.py",
)

kernel = kernel_compiler(_SOURCES)
run_kernel = run_kernel_compiler(_SOURCES)
