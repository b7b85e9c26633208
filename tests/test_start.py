"""Tests of `jaxtrack.start`, each in a process where jax is not there yet."""

import os
import pathlib
import subprocess
import sys

import pytest

from jaxtrack import start

OWN = "JAX", "XLA", "OPENBLAS"  # variables that change how it starts
ROOT = pathlib.Path(__file__).parent.parent


def told_by(code, **environment):
    """Runs Python and returns the words that it prints."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith(OWN)}
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**kept, "PYTHONPATH": str(ROOT), **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert not done.returncode, done.stderr
    return done.stdout.split()


COUNT = """
import jax
from jaxtrack import start
{before}
start.cores()
print(jax.local_device_count())
"""
CORES = str(len(os.sched_getaffinity(0))) if hasattr(os, "sched_getaffinity") else ""


@pytest.mark.parametrize(
    ("before", "environment", "expected"),
    [
        ("", {}, CORES),
        ("", {"JAX_NUM_CPU_DEVICES": "3"}, "3"),
        ("", {"XLA_FLAGS": "--xla_force_host_platform_device_count=3"}, "3"),
        ("jax.numpy.zeros(1)", {}, "1"),
    ],
)
def test_cores_are_devices_unless_told_otherwise(before, environment, expected):
    if expected:
        assert told_by(COUNT.format(before=before), **environment) == [expected]


THREADS = """
import re
import jax
from jaxtrack import start
start.cores()
jax.numpy.linalg.cholesky(jax.numpy.eye(8)).block_until_ready()
import ctypes
loaded = open("/proc/self/maps").read()
for path in set(re.findall(r"/.*libscipy_openblas-.*", loaded)):
    print(ctypes.CDLL(path).scipy_openblas_get_num_threads())
"""


@pytest.mark.skipif(sys.platform != "linux", reason="reads which libraries are loaded")
@pytest.mark.parametrize("told", [None, "2"])
def test_lapack_has_one_thread_unless_told_otherwise(told):
    environment = {"OPENBLAS_NUM_THREADS": told} if told else {}
    counts = told_by(THREADS, **environment)
    if not counts:
        pytest.skip("LAPACK is not SciPy's OpenBLAS")
    assert counts == [told or "1"]


FUSED = """
import os
from jaxtrack import start
start.fusion()
start.cores()
start.fusion()
print(os.environ["XLA_FLAGS"])
import jax
print(jax.jit(lambda x: x + 1)(1))
"""
OPTION = "--xla_backend_extra_options="
OTHER = "xla_cpu_small_while_loop_byte_threshold=1024"


@pytest.mark.parametrize(
    ("flags", "expected"),
    [
        ("", [f"{OPTION}{start.FUSION}"]),
        (
            f"{OPTION}{OTHER} --xla_cpu_enable_fast_math=false",
            [f"{OPTION}{OTHER},{start.FUSION}", "--xla_cpu_enable_fast_math=false"],
        ),
    ],
)
def test_fusion_is_asked_of_xla_beside_other_flags(flags, expected):
    *found, devices, answer = told_by(FUSED, XLA_FLAGS=flags)
    assert found == expected
    assert devices.startswith(start.DEVICES)
    assert answer == "2"


def test_fusion_after_the_first_array_is_refused():
    # The array is made here, by whatever test came first or by this one.
    import jax

    jax.numpy.zeros(1)
    flags = os.environ.get("XLA_FLAGS")
    with pytest.raises(RuntimeError, match="too late; call it before"):
        start.fusion()
    assert os.environ.get("XLA_FLAGS") == flags


CACHE = """
from jaxtrack.cli import common
common.start_jax(64)
import jax
jax.jit(lambda x: x + 1)(1.0)
"""


@pytest.mark.parametrize(
    ("environment", "folder"),
    [
        ({}, "home/jaxtrack/jax"),
        ({"JAX_COMPILATION_CACHE_DIR": "mine"}, "mine"),
        ({"JAX_ENABLE_COMPILATION_CACHE": "false"}, None),
    ],
)
def test_cache_can_be_moved_and_switched_off(tmp_path, environment, folder):
    home = {"XDG_CACHE_HOME": str(tmp_path / "home")}
    if "JAX_COMPILATION_CACHE_DIR" in environment:
        environment = {"JAX_COMPILATION_CACHE_DIR": str(tmp_path / "mine")}
    told_by(CACHE, **home, **environment)
    files = [x for x in tmp_path.rglob("*") if x.is_file()]
    assert bool(files) == bool(folder)
    assert all(x.is_relative_to(tmp_path / str(folder)) for x in files)


def test_command_line_asks_for_fusion_where_the_environment_does():
    code = "from jaxtrack.cli import common; common.start_jax(64); import os; "
    code += "print(os.environ['XLA_FLAGS'])"
    off = {"JAX_ENABLE_COMPILATION_CACHE": "false"}
    assert f"{OPTION}{start.FUSION}" in told_by(code, JAXTRACK_FUSION="1", **off)
    assert f"{OPTION}{start.FUSION}" not in told_by(code, JAXTRACK_FUSION="0", **off)
