"""OpenBLAS, which multiplies NumPy's matrices, on one thread in each of ours.

The products are too small for several threads of OpenBLAS, and the bits would depend on their number. So importing
`sfmrl.fast` sets OpenBLAS to one thread, by a call to the library that NumPy has loaded. It works in a notebook, too,
where NumPy was imported first. The command also sets OPENBLAS_NUM_THREADS before it imports NumPy, unless you have set
it, so that no other threads are started. The setting holds for the whole process: for large products of your own, raise
it afterwards (threadpoolctl's `threadpool_limits` does), and set it back before you play or train. If your NumPy uses
another library, set that library's variable to 1, such as MKL_NUM_THREADS or VECLIB_MAXIMUM_THREADS.
"""

import ctypes
from pathlib import Path
from typing import Any

import numpy as np


def _openblas(function: str) -> Any:
    """A function of the OpenBLAS that NumPy uses, by its name without "openblas_"; None without OpenBLAS."""
    folder = Path(np.__file__).parent
    # Functions are found through NumPy's own library, which is linked to OpenBLAS; on Windows, in OpenBLAS itself.
    for file in (*folder.glob("*core/_multiarray_umath*"), *folder.parent.glob("numpy.libs/*openblas*")):
        try:
            library = ctypes.CDLL(str(file))
        except OSError:
            continue
        for name in (f"{prefix}openblas_{function}{suffix}" for prefix in ("scipy_", "") for suffix in ("64_", "")):
            if hasattr(library, name):
                return getattr(library, name)
    return None


def kernels() -> str:
    """Which of OpenBLAS's kernels NumPy uses here, as "Haswell" or "SkylakeX"; "unknown" without OpenBLAS."""
    name = _openblas("get_corename")
    if name is None:
        return "unknown"
    name.restype = ctypes.c_char_p
    return name().decode()


if _set := _openblas("set_num_threads"):
    _set(1)
