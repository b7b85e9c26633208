"""How jax starts: as many devices as cores, programs kept on disk, an experiment.

The command line does the first two by itself. In Python, call what you want before the
rest of jaxtrack is imported, or at least before the first array is made:

    >>> from jaxtrack import start
    >>> start.cache_folder({"XDG_CACHE_HOME": "/data"}).as_posix()
    '/data/jaxtrack/jax'
"""

import contextlib
import os
import pathlib
import re
from collections.abc import Mapping

DEVICES = "--xla_force_host_platform_device_count"
OPTIONS = "--xla_backend_extra_options"
FUSION = "xla_cpu_use_multi_output_fusion"
KEEP_ALL = {
    "jax_persistent_cache_min_compile_time_secs": 0,
    "jax_persistent_cache_min_entry_size_bytes": -1,
}


def cores() -> None:
    """Makes every core a device, among which `engine` shares runs.

    Does nothing where XLA_FLAGS or JAX_NUM_CPU_DEVICES says how many devices there are,
    or after the first array. LAPACK, which works on large matrices, gets one thread,
    unless OPENBLAS_NUM_THREADS says otherwise.
    """
    one_blas_thread()
    import jax

    flags = os.environ.get("XLA_FLAGS", "")
    told = DEVICES in flags or jax.config.values["jax_num_cpu_devices"] >= 0
    if not told and not _begun():
        _set_flags(f"{flags} {DEVICES}={_count()}")


def one_blas_thread() -> None:
    """Gives LAPACK, which XLA calls on a CPU, one thread: runs share the cores.

    More of them wait for each other: rmm-mht, whose matrices have up to 40 rows, takes
    1.4 times as long with two threads on two cores, and 10 times on one. Must come
    before SciPy is imported, as `jaxtrack.engine` does, since its LAPACK makes threads
    then; does nothing where OPENBLAS_NUM_THREADS is set.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def cache() -> None:
    """Keeps compiled programs on disk, so that the next process starts sooner.

    They go to JAX_COMPILATION_CACHE_DIR, by default to `cache_folder`;
    JAX_ENABLE_COMPILATION_CACHE=false switches this off. Tracing is not saved: a Kalman
    filter is there in 0.2 s, a tracker of several modes in 5 s.
    """
    import jax

    if not jax.config.values["jax_enable_compilation_cache"]:
        return
    if jax.config.values["jax_compilation_cache_dir"] is None:
        folder = cache_folder(os.environ)
        with contextlib.suppress(OSError):  # a cache is not worth an error
            folder.mkdir(parents=True, exist_ok=True)
            jax.config.update("jax_compilation_cache_dir", str(folder))
    # Many short compilations take long together, so none is too short to keep.
    for name, value in KEEP_ALL.items():
        if name.upper() not in os.environ:
            jax.config.update(name, value)


def cache_folder(environment: Mapping[str, str]) -> pathlib.Path:
    """Returns where compiled programs are kept, jaxtrack/jax in the user's cache."""
    home = environment.get("XDG_CACHE_HOME") or pathlib.Path.home() / ".cache"
    return pathlib.Path(home, "jaxtrack", "jax")


def fusion() -> None:
    """Lets XLA compute several results in one loop on a CPU: experimental.

    Measured at the time of writing: gm-mm-cbmember runs at 1.2 to 1.4 times its speed,
    imm-mm-cbmember at 0.7 to 1.0, and the Kalman filter, which is written to do
    without, at 0.5 to 0.9. XLA promises nothing about this flag, so measure your work.

    Raises:
        RuntimeError: An array was made before, so XLA has read its flags.
    """
    if _begun():
        raise RuntimeError(
            "start.fusion() comes after the first array, which is too late; call it "
            "before anything of jax is used"
        )
    flags = os.environ.get("XLA_FLAGS", "")
    if FUSION in flags:
        return
    if OPTIONS in flags:
        _set_flags(re.sub(rf"{OPTIONS}=(\S*)", rf"{OPTIONS}=\1,{FUSION}", flags))
    else:
        _set_flags(f"{flags} {OPTIONS}={FUSION}")


def _begun() -> bool:
    """Returns whether XLA has read its flags, which it does once."""
    import jax

    now = jax.config.values["jax_num_cpu_devices"]
    try:
        # This one may be changed until then, and only until then.
        jax.config.update("jax_num_cpu_devices", now + 1)
    except RuntimeError:
        return True
    jax.config.update("jax_num_cpu_devices", now)
    return False


def _set_flags(flags: str) -> None:
    os.environ["XLA_FLAGS"] = flags.strip()


def _count() -> int:
    """Returns how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
