"""The compiler of the world's kernels."""

from hil_forceps.rig.kernel import kernel_compiler, subroutine

__all__ = ["kernel", "subroutine"]

kernel = kernel_compiler(
    (
        "virtual_bus/plant",
        "virtual_bus/effects",
        "virtual_bus/logs.py",
        "virtual_bus/bus",
        "firmware_protocol/scales.py",
    )
)
