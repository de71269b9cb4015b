"""The compiler of the estimators' kernels."""

from hil_forceps.kernels.compiler import (
    inlined,
    kernel_compiler,
    returning_arrays,
    run_kernel_compiler,
    subroutine,
    with_work_arrays,
)

__all__ = ["inlined", "kernel", "returning_arrays", "run_kernel", "subroutine", "with_work_arrays"]

_SOURCES = (
    "hil_forceps/effects",
    "hil_forceps/model",
    "hil_forceps/estimation",
    "hil_forceps/rig/plant.py",
)

kernel = kernel_compiler(_SOURCES)
run_kernel = run_kernel_compiler(_SOURCES)
