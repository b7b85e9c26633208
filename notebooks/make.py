"""Runs notebooks in place and keeps of their outputs what readers want to see.

    python notebooks/make.py           # all of them
    python notebooks/make.py 01 07     # those whose names begin so

What changes from one machine or minute to the next without meaning anything, such as
execution times and versions of the kernel, is left out, so that differences stay small.
Compiled programs are kept in `.cache/`, as those of the tests are.
"""

import os
import pathlib
import sys
import time

import nbclient
import nbformat

HERE = pathlib.Path(__file__).parent
LANGUAGE = {"name": "python"}
KERNEL = {"name": "python3", "display_name": "Python 3", "language": "python"}
TIMEOUT = 600  # seconds a cell
CHATTER = ("stderr",)  # streams in which nothing may stand


def paths(names: list[str]) -> list[pathlib.Path]:
    """Returns the notebooks whose names begin with one of these, all if there is none.

    Raises:
        ValueError: A name that no notebook has.
    """
    every = sorted(HERE.glob("[0-9]*.ipynb"))
    for name in names:
        if not any(path.name.startswith(name) for path in every):
            there = ", ".join(path.stem for path in every)
            raise ValueError(f"no notebook begins with {name!r}; there are {there}")
    chosen = tuple(names)
    return [path for path in every if not chosen or path.name.startswith(chosen)]


def execute(notebook: nbformat.NotebookNode, folder: pathlib.Path) -> None:
    """Runs all cells in a fresh kernel; their outputs replace the old ones.

    Raises:
        CellExecutionError: A cell failed.
    """
    client = nbclient.NotebookClient(
        notebook,
        timeout=TIMEOUT,
        kernel_name=KERNEL["name"],
        resources={"metadata": {"path": str(folder)}},
    )
    client.execute()


def environment() -> dict[str, str]:
    """Returns what the kernel needs to know: its cache, and no check of a debugger."""
    cache, path = str(HERE.parent / ".cache" / "jax"), [str(HERE.parent)]
    path += filter(None, [os.environ.get("PYTHONPATH")])
    return {
        "JAX_COMPILATION_CACHE_DIR": os.environ.get("JAX_COMPILATION_CACHE_DIR", cache),
        "PYTHONPATH": os.pathsep.join(path),
        "PYDEVD_DISABLE_FILE_VALIDATION": "1",
    }


def complaints(notebook: nbformat.NotebookNode) -> list[str]:
    """Returns what cells said that they should not: errors and warnings."""
    outputs = [out for cell in notebook.cells for out in cell.get("outputs", [])]
    said = [
        out.get("text") or f"{out.get('ename')}: {out.get('evalue')}"
        for out in outputs
        if out.output_type == "error" or out.get("name") in CHATTER
    ]
    return [str(text) for text in said]


def strip(notebook: nbformat.NotebookNode) -> None:
    """Drops what changes from run to run without meaning anything."""
    notebook.metadata = {"kernelspec": KERNEL, "language_info": LANGUAGE}
    for n, cell in enumerate(notebook.cells):
        cell.id, cell.metadata = f"cell-{n:02}", {}
        for out in cell.get("outputs", []):
            out.pop("metadata", None)
            if out.output_type in ("display_data", "execute_result"):
                out.metadata = {}
                if "image/png" in out.data:  # "<Figure size ...>" says nothing more
                    out.data.pop("text/plain", None)


def main(names: list[str]) -> None:
    """Runs the notebooks and writes them anew."""
    os.environ.update(environment())
    for path in paths(names):
        notebook = nbformat.read(path, as_version=4)
        before = time.perf_counter()
        execute(notebook, HERE)
        for text in complaints(notebook):
            sys.exit(f"{path.name} complains: {text}")
        strip(notebook)
        nbformat.write(notebook, path)
        size = path.stat().st_size / 1000
        print(f"{path.name}: {time.perf_counter() - before:.1f} s, {size:.0f} kB")


if __name__ == "__main__":
    main(sys.argv[1:])
