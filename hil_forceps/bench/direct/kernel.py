"""The compiler of the bench's kernels."""

from hil_forceps.kernels.compiler import kernel_compiler

kernel = kernel_compiler(
    (
        "hil_forceps/effects",
        "hil_forceps/model",
        "hil_forceps/estimation",
        "hil_forceps/control/compensator.py",
        "hil_forceps/bench/direct/run_ahead.py",
        "hil_forceps/rig/plant.py",
    )
)
