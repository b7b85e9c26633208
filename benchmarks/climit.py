"""The loops of `climit.c`, built when they are first needed and kept in `.cache`.

    >>> from benchmarks import climit
    >>> climit.lanes("float32")
    16

Without gcc there is no limit, and benchmarks leave that column empty.
"""

import ctypes
import functools
import hashlib
import pathlib
import platform
import shutil
import subprocess
from collections.abc import Callable
from typing import Any

import numpy as np

SOURCE = pathlib.Path(__file__).with_name("climit.c")
CACHE = pathlib.Path(__file__).parent.parent / ".cache" / "benchmarks"
FLAGS = (
    *("-std=gnu11", "-O3", "-march=native", "-mprefer-vector-width=512"),
    *("-ffast-math", "-fPIC", "-shared"),
)


def lanes(precision: str) -> int:
    """Returns what the number of runs must be a multiple of."""
    return 64 // np.dtype(precision).itemsize


@functools.cache
def library(precision: str) -> ctypes.CDLL | None:
    """Builds the loops for one precision, or returns None where that fails."""
    compiler = shutil.which("gcc")
    if compiler is None:
        return None
    flags = [*FLAGS, *(["-DSINGLE"] if precision == "float32" else [])]
    # Another processor needs another build.
    identity = " ".join([*flags, cpu_model(), SOURCE.read_text()])
    digest = hashlib.sha256(identity.encode()).hexdigest()[:16]
    path = CACHE / f"climit-{digest}.so"
    if not path.exists():
        CACHE.mkdir(parents=True, exist_ok=True)
        command = [compiler, *flags, "-o", str(path), str(SOURCE), "-lmvec", "-lm"]
        if subprocess.run(command, check=False).returncode:
            return None
    return ctypes.CDLL(str(path))


def call(name: str, precision: str, *arguments: Any) -> Callable[[], None] | None:
    """Returns a call of a loop, or None where there is no compiler.

    Args:
        name: Of the function in `climit.c`.
        precision: float32 or float64.
        arguments: Arrays of that precision, contiguous; ints; floats.
    """
    loops = library(precision)
    if loops is None:
        return None
    function = getattr(loops, name)
    real = ctypes.c_float if precision == "float32" else ctypes.c_double

    def passed(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            if value.dtype != precision or not value.flags.c_contiguous:
                raise ValueError(f"an array of {name} is not contiguous {precision}")
            return value.ctypes.data_as(ctypes.c_void_p)
        return ctypes.c_long(value) if isinstance(value, int) else real(value)

    given = [passed(value) for value in arguments]

    def run() -> None:
        function(*given)

    run.arrays = arguments  # or they would be freed
    return run


def cpu_model() -> str:
    """Returns the name of the processor."""
    try:
        for line in pathlib.Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()
