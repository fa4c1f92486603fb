"""Calls made ready in C, so that calling a compiled function costs little more than what it does."""

import ctypes
import sys
import sysconfig
from collections.abc import Callable
from functools import cache
from importlib.machinery import ExtensionFileLoader, ModuleSpec
from importlib.util import module_from_spec
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from sigmax.native.build import Unavailable, built
from sigmax.native.driver import over_cores

_SOURCE = Path(__file__).parent / "c" / "call.c"


@cache
def extension() -> ModuleType | None:
    """The Python module made from call.c, or None where the headers of Python or a compiler are missing."""
    headers = sysconfig.get_path("include")
    # Without a global lock two threads could fill the arrays of one call at once.
    if not (headers and Path(headers, "Python.h").exists()) or sysconfig.get_config_var("Py_GIL_DISABLED"):
        return None
    source = f"/* Python {sys.version.splitlines()[0]}, NumPy {np.__version__} */\n{_SOURCE.read_text()}"
    settings = ["-O2", f"-I{headers}", f"-I{np.get_include()}"]
    if sys.platform == "darwin":
        settings.append("-Wl,-undefined,dynamic_lookup")
    try:
        path = str(built(source, tuple(settings)))
        loader = ExtensionFileLoader("call", path)
        module = module_from_spec(ModuleSpec("call", loader, origin=path))
        loader.exec_module(module)
    except (Unavailable, ImportError):
        return None
    return module


def ready(
    function: Any,
    job: ctypes.Structure | None,
    tracks: int,
    inputs: tuple[np.ndarray, ...],
    outputs: tuple[np.ndarray, ...],
    kind: type[tuple[Any, ...]] | None = None,
    long: bool = False,
    kept: Any = None,
) -> Callable[..., Any]:
    """A function of the driver bound to the arrays it reads and writes, of float64 or float32, row by row.

    It takes a value for each of the `inputs`, copies them there (None leaves the array as it is), calls the
    function and returns copies of the `outputs`: nothing, one array, or a tuple of the type `kind`. Where a
    value is not clearly what belongs there, it does nothing and returns NotImplemented.

    Args:
        function: the function of the driver; None where the outputs are only to be read.
        job: what it works on.
        tracks: how many.
        inputs: what the job reads; an empty array where there is nothing to be given.
        outputs: what the job writes.
        kind: a named tuple.
        long: whether other threads should run meanwhile.
        kept: whatever else must live as long.
    """
    module = extension() if tracks == 1 else None
    held = function, job, kept
    if module is not None:
        where = (0, 0) if job is None else (ctypes.cast(function, ctypes.c_void_p).value, ctypes.addressof(job))
        made: Callable[..., Any] = module.ready(*where, inputs, outputs, kind, held, long)
        return made
    single = (*inputs, *outputs)[0].dtype == np.float32

    def call(*values: Any, _held: Any = held) -> Any:
        for array, value in zip(inputs, values, strict=True):
            if value is not None:
                if not _fits(value, array):
                    return NotImplemented
                array[...] = value
        if job is not None:
            over_cores(function, job, tracks, single)
        if kind is not None:
            return kind(*[a.copy() if a.ndim else a[()] for a in outputs])
        return outputs[0].copy() if outputs else None

    return call


def _fits(value: Any, array: np.ndarray) -> bool:
    if type(value) is np.ndarray:
        return value.shape == array.shape and value.dtype == array.dtype
    return isinstance(value, float) and array.ndim == 0
