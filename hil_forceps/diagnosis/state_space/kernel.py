"""The compiler of the filter's kernels."""

from hil_forceps.kernels.compiler import (
    as_its_caller,
    inlined,
    kernel_compiler,
    returning_arrays,
    run_kernel_compiler,
    subroutine,
    with_work_arrays,
)

__all__ = [
    "as_its_caller",
    "inlined",
    "kernel",
    "returning_arrays",
    "run_kernel",
    "subroutine",
    "vectorised_run_kernel",
    "with_work_arrays",
]

_SOURCES = ("hil_forceps/effects", "hil_forceps/model", "hil_forceps/diagnosis/state_space", "hil_forceps/rig/plant.py")

kernel = kernel_compiler(_SOURCES)
run_kernel = run_kernel_compiler(_SOURCES)
vectorised_run_kernel = run_kernel_compiler(_SOURCES, vectorised=True)
