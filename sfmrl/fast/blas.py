"""OpenBLAS, NumPy's library for matrix products: importing `sfmrl.fast` sets it to one thread, in the whole process.

The network's products are too small for several threads of OpenBLAS, and the bits would depend on their number. (The
command also sets OPENBLAS_NUM_THREADS, unless you have, before it imports NumPy, so that no thread is started.) For
large products of your own raise the number afterwards, as with threadpoolctl's `threadpool_limits`, and set it back
before you play or train. NumPy may use Accelerate (recent Macs) or MKL instead: the command also sets
VECLIB_MAXIMUM_THREADS and MKL_NUM_THREADS; in Python, set them to 1 before you import NumPy.
"""

import ctypes
from pathlib import Path
from typing import Any

import numpy as np


def _openblas(function: str) -> Any:
    """A function of the OpenBLAS that NumPy uses, by its name without "openblas_"; None without OpenBLAS."""
    folder = Path(np.__file__).parent
    # NumPy's own library is linked to OpenBLAS and finds its functions; on Windows, OpenBLAS itself is asked.
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
    """The name of OpenBLAS's kernels for this processor, as "Haswell" or "SkylakeX"; "unknown" without OpenBLAS."""
    name = _openblas("get_corename")
    if name is None:
        return "unknown"
    name.restype = ctypes.c_char_p
    return name().decode()


if _set := _openblas("set_num_threads"):
    _set(1)
