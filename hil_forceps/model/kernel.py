"""The compiler of the model's kernels."""

from hil_forceps.rig.kernel import kernel_compiler

_SOURCES = ("hil_forceps/effects", "hil_forceps/model", "hil_forceps/rig/plant.py")

kernel = kernel_compiler(_SOURCES)
inlined = kernel_compiler(_SOURCES, inline=True)
