"""What is done of a study, kept on disk, so that a killed study goes on.

A part is the outcome of one chunk of runs, of one tracker at one point of the sweep. It
is written whole or not at all, and carries its identity: a study never takes up the
parts of another, or of another version of the library.

    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> from jaxtrack.study import parts, sweep
    >>> plan = sweep.plan("yuan2013-linear", ["gm-cv-cbmember"], runs=99, seed=0)
    >>> path = parts.path_of(tempfile.mkdtemp(), plan.jobs[0], first=50)
    >>> path.name
    'default gm-cv-cbmember 000050.npz'
    >>> part = parts.Part({"ospa": np.ones((2, 3))}, 1.0, 0.0, example={})
    >>> parts.write(path, {"seed": 0}, part)
    >>> parts.read(path, {"seed": 0}).scores["ospa"].shape
    (2, 3)
"""

import contextlib
import hashlib
import json
import os
import pathlib
import types
import zipfile
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxtrack.study import sweep

Directory = str | os.PathLike[str]


class ForeignPart(ValueError):
    """Says that a directory holds parts of another study."""


class Part(NamedTuple):
    """What one compiled call yields.

    Attributes:
        scores: [R, T] for each field of `scores.Scores`.
        seconds: How long the call took.
        compile_seconds: How long it took to compile it, 0 if it was compiled already.
        example: Scans and estimates of run 0 by name, each with a leading T; empty in
            the parts that begin with another run.
    """

    scores: Mapping[str, np.ndarray]
    seconds: float
    compile_seconds: float
    example: Mapping[str, np.ndarray]


def fingerprint(values: Any) -> str:
    """Returns a digest of the numbers in a pytree and of what computes with them."""
    digest = hashlib.sha256(jax.__version__.encode())
    for leaf in jax.tree.leaves(values):
        digest.update(np.asarray(leaf).tobytes())
    root = pathlib.Path(__file__).parent.parent
    for path in sorted(root.rglob("*.py")):
        if path.relative_to(root).parts[0] not in ("cli", "data", "plot.py", "plot"):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def path_of(directory: Directory, job: sweep.Job, first: int) -> pathlib.Path:
    """Returns where the part that begins with run `first` is kept."""
    setting = sweep.label(job.point).replace(", ", ",")
    return pathlib.Path(directory, "parts", f"{setting} {job.name} {first:06d}.npz")


def write(path: pathlib.Path, identity: Mapping[str, Any], part: Part) -> None:
    """Writes a part; whoever reads finds all of it or nothing."""
    path.parent.mkdir(parents=True, exist_ok=True)
    arrays = {f"scores.{name}": array for name, array in part.scores.items()}
    arrays |= {f"example.{name}": array for name, array in part.example.items()}
    arrays["times"] = np.array([part.seconds, part.compile_seconds])
    arrays["identity"] = np.array(json.dumps(identity))
    temporary = path.with_name(f"{path.name}.{os.getpid()}")
    with temporary.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)
    os.replace(temporary, path)


def read(path: pathlib.Path, identity: Mapping[str, Any] | None = None) -> Part | None:
    """Reads a part; None if there is none, or it is damaged.

    Args:
        path: Of `path_of`.
        identity: What the part must be; without it, any will do.

    Raises:
        ForeignPart: The part is of another study.
    """
    try:
        with path.open("rb") as file, np.load(file) as loaded:
            arrays = dict(loaded)
        found = json.loads(str(arrays["identity"]))
        seconds, compile_seconds = (float(x) for x in arrays["times"])
    except (OSError, EOFError, KeyError, ValueError, zipfile.BadZipFile):
        return None
    for name, value in (identity or {}).items():
        if found.get(name) != value:
            raise ForeignPart(
                f"{path.parent} holds parts of another study ({name} is "
                f"{found.get(name)}, not {value}); remove it or give another directory"
            )
    scores, example = _group(arrays, "scores."), _group(arrays, "example.")
    return Part(scores, seconds, compile_seconds, example)


def read_example(directory: Directory, job: sweep.Job) -> Any:
    """Reads what run 0 of a job saw and told.

    Returns:
        A namespace with `detections`, `valid` and `interval` of the scans and all
        fields of the tracker's `Estimate`, each with a leading T.

    Raises:
        ValueError: The directory does not hold it.
    """
    path = path_of(directory, job, 0)
    part = read(path)
    if part is None:
        raise ValueError(f"{path} is missing; run the study with this directory")
    return types.SimpleNamespace(**part.example)


def discard(directory: Directory, plan: sweep.Plan) -> None:
    """Removes the parts of a study that is complete."""
    for job in plan.jobs:
        for runs in plan.chunks:
            path_of(directory, job, runs.start).unlink(missing_ok=True)
    with contextlib.suppress(OSError):  # others may have parts there
        pathlib.Path(directory, "parts").rmdir()


def _group(arrays: Mapping[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    names = [name for name in arrays if name.startswith(prefix)]
    return {name.removeprefix(prefix): arrays[name] for name in names}
