"""The compiler of the filter's kernels."""

from hil_forceps.rig.kernel import (
    as_its_caller,
    inlined,
    kernel_compiler,
    returning_arrays,
    subroutine,
    with_work_arrays,
)

__all__ = ["as_its_caller", "inlined", "kernel", "returning_arrays", "subroutine", "with_work_arrays"]

_SOURCES = ("hil_forceps/effects", "hil_forceps/model", "hil_forceps/diagnosis/state_space", "hil_forceps/rig/plant.py")

kernel = kernel_compiler(_SOURCES)
