"""The compiler of this folder's kernels."""

from hil_forceps.rig.kernel import kernel_compiler

kernel = kernel_compiler(("hil_forceps/diagnosis/drift",))
