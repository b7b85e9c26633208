"""The notebooks run without a word of complaint, and show what they should."""

import ast
import importlib
import pathlib
import re

import nbformat
import pytest

from notebooks import make

FOLDER = pathlib.Path(__file__).parent.parent / "notebooks"
PATHS = sorted(FOLDER.glob("[0-9]*.ipynb"))
MAX_FUNCTION_LINES = 9
MAX_BYTES = 300_000
MACHINE = re.compile(r"/(?:home|root|tmp|work|usr|Users)/")

by_name = pytest.mark.parametrize("path", PATHS, ids=lambda path: path.stem)


def cells(path, kind):
    return [cell for cell in nbformat.read(path, 4).cells if cell.cell_type == kind]


def pictures(cell):
    return sum("image/png" in out.get("data", {}) for out in cell.get("outputs", []))


def tree(path):
    """All its code as one syntax tree, less what is said to IPython."""
    lines = "\n".join(cell.source for cell in cells(path, "code")).splitlines()
    return ast.parse("\n".join(x for x in lines if not x.startswith("%")))


def test_every_notebook_is_in_the_index():
    told = re.findall(r"\((\d\d_\w+\.ipynb)\)", (FOLDER / "README.md").read_text())
    assert told == [path.name for path in PATHS]


@by_name
def test_notebook_begins_with_its_number_and_title(path):
    number = int(path.name[:2])
    assert nbformat.read(path, 4).cells[0].source.startswith(f"# {number}. ")


@by_name
def test_outputs_are_kept_and_small_and_complain_of_nothing(path):
    notebook = nbformat.read(path, 4)
    assert make.complaints(notebook) == []
    code = cells(path, "code")
    assert sum(pictures(cell) for cell in code) >= 2
    counts = [cell.execution_count for cell in code]
    assert counts == list(range(1, len(code) + 1)), "not run from top to bottom"
    assert path.stat().st_size < MAX_BYTES
    assert not MACHINE.search(path.read_text())


@by_name
def test_metadata_is_what_the_script_leaves(path):
    notebook = nbformat.read(path, 4)
    before = nbformat.writes(notebook)
    make.strip(notebook)
    assert nbformat.writes(notebook) == before


@by_name
def test_no_library_code_is_defined(path):
    for node in ast.walk(tree(path)):
        assert not isinstance(node, ast.ClassDef)
        if isinstance(node, ast.FunctionDef):
            length = node.end_lineno - node.lineno + 1
            assert length <= MAX_FUNCTION_LINES, f"{node.name} has {length} lines"


@by_name
def test_only_public_names_are_used(path):
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Attribute):
            assert not node.attr.startswith("_") or node.attr == "_replace"
        if isinstance(node, ast.ImportFrom) and node.module.startswith("jaxtrack"):
            module = importlib.import_module(node.module)
            for alias in node.names:
                assert not alias.name.startswith("_")
                if not hasattr(module, alias.name):
                    importlib.import_module(f"{node.module}.{alias.name}")


@pytest.mark.slow
@by_name
def test_notebook_runs(path, tmp_path, monkeypatch):
    for name, value in make.environment().items():
        monkeypatch.setenv(name, value)
    notebook = nbformat.read(path, 4)
    kept = [pictures(cell) for cell in notebook.cells]
    make.execute(notebook, tmp_path)  # the file itself stays as it is
    assert make.complaints(notebook) == []
    assert [pictures(cell) for cell in notebook.cells] == kept
