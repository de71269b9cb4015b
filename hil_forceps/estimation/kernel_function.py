"""Kernels as arguments of kernels: a compiled loop takes any estimator's steps without being compiled for it.

numba compiles a loop again for every compiled function among its arguments, and does not cache the result. A function
that is given by its address and signature has one type for all estimators.
"""

from collections.abc import Callable
from typing import Any

from numba import types

# numba itself imports this when it first compiles something. Until then it knows no type for a `KernelFunction`, and a
# loop that comes out of the cache compiles nothing before it is called.
from numba.experimental import function_type  # noqa: F401

_VECTOR = types.Array(types.float64, 1, "C")
_SAMPLE = (types.int64, types.float64, types.float64)  # stamp, angle, torque


class KernelFunction(types.WrapperAddressProtocol):
    """A kernel of one signature as a value; compiled when it is first used."""

    def __init__(self, kernel: Callable[..., Any], signature: Any) -> None:
        self._kernel: Any = kernel
        self._signature = signature
        self._address: int | None = None

    @classmethod
    def of_start(cls, kernel: Callable[..., Any]) -> "KernelFunction":
        """Return an estimator's start: constants and a sample to a state."""
        return cls(kernel, _VECTOR(_VECTOR, *_SAMPLE))

    @classmethod
    def of_step(cls, kernel: Callable[..., Any]) -> "KernelFunction":
        """Return an estimator's step: state, constants and a sample to a state."""
        return cls(kernel, _VECTOR(_VECTOR, _VECTOR, *_SAMPLE))

    @property
    def function(self) -> Callable[..., Any]:
        """The kernel itself."""
        kernel: Callable[..., Any] = self._kernel
        return kernel

    def __call__(self, *arguments: Any) -> Any:
        """Call the kernel; for the type checker, which sees kernels as the functions that they were."""
        return self._kernel(*arguments)

    def signature(self) -> Any:
        """Return numba's signature (numba's protocol)."""
        return self._signature

    def __wrapper_address__(self) -> int:
        """Return where the compiled function is (numba's protocol)."""
        if self._address is None:
            self._kernel.compile(self._signature.args)
            compiled = self._kernel.get_compile_result(self._signature)
            self._address = compiled.library.get_pointer_to_function(compiled.fndesc.llvm_cfunc_wrapper_name)
        return self._address
