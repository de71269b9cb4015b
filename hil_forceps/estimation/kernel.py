"""The compiler of the estimators' kernels."""

from hil_forceps.rig.kernel import inlined, kernel_compiler, subroutine

__all__ = ["inlined", "kernel", "subroutine"]

_SOURCES = (
    "hil_forceps/effects",
    "hil_forceps/model",
    "hil_forceps/estimation",
    "hil_forceps/rig/plant.py",
)

kernel = kernel_compiler(_SOURCES)
