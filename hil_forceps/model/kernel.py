"""The compiler of the model's and the estimators' kernels."""

from hil_forceps.rig.kernel import kernel_compiler

kernel = kernel_compiler(("hil_forceps/model", "hil_forceps/estimation", "hil_forceps/rig/plant.py"))
