"""Strict numerics for every test: float64, no silent broadcasting of ranks.

Nearly all the time of a test is compilation, so XLA is asked for plain code (the same
program with fewer passes over it: three times as fast to make, slower to run), and the
persistent cache makes the second run of the suite fast.
"""

import os
import pathlib

import jax
import pytest

CACHE = pathlib.Path(__file__).parent.parent / ".cache" / "jax"
PLAIN_CODE = (
    "--xla_backend_optimization_level=0",
    "--xla_llvm_disable_expensive_passes=true",
    "--xla_cpu_use_fusion_emitters=false",
    "--xla_cpu_parallel_codegen_split_count=1",
)

# Before LAPACK is loaded: on cores that tests share, its threads wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Before the first array is made; processes that a test starts inherit it.
os.environ["XLA_FLAGS"] = " ".join([os.environ.get("XLA_FLAGS", ""), *PLAIN_CODE])

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
if jax.config.jax_compilation_cache_dir is None:  # unless the environment names one
    jax.config.update("jax_compilation_cache_dir", str(CACHE))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


@pytest.fixture(scope="module")
def whole_matrices():
    """Matrices stay arrays however small, in half as long programs.

    For files about what stands above the algebra; that both forms tell the same, with
    right gradients, is held in `test_linalg`, and the contracts of targets and of
    trackers are kept with small matrices written out, as are published results.
    """
    from jaxtrack import linalg  # not before the flags above are set

    before, linalg.UNROLL = linalg.UNROLL, 1
    yield
    linalg.UNROLL = before


@pytest.fixture(autouse=True, scope="module")
def _programs_go():
    """Forgets the programs that a file compiled: all of them take gigabytes."""
    yield
    jax.clear_caches()
