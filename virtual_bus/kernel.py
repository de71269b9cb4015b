"""The compiler of the world's kernels."""

from hil_forceps.rig.kernel import kernel_compiler

kernel = kernel_compiler(("virtual_bus", "firmware_protocol/scales.py"))
