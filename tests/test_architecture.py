"""The shape of the code itself: one staircase, small files, docstrings, examples."""

import ast
import graphlib
import pathlib

import pytest

import jaxtrack

ROOT = pathlib.Path(jaxtrack.__file__).parent
FILES = sorted(ROOT.rglob("*.py"))
MODULES = [path for path in FILES if path.name != "__init__.py"]

# A module imports from lower floors, or from its own floor if that makes no cycle.
FLOORS = (
    {"types", "constraints", "start"},
    {"entries"},
    {"linalg", "models"},
    {
        *("linearize", "kalman", "kalman_parallel", "mixture", "cardinality"),
        *("particle", "resampling", "transport", "rcm_kalman"),
    },
    {"assign"},
    {"gate", "imm"},
    {"targets"},
    {"trackers"},
    {"engine", "study", "recorded", "metrics", "scenarios", "learn", "data", "plot"},
    {"cli"},
)
FLOOR = {room: level for level, rooms in enumerate(FLOORS) for room in rooms}
MAX_FILE_LINES = 300
MAX_BODY_LINES = 40


def name_of(path):
    """The dotted name of a module below the package: models.motion, kalman."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


NAMES = {name_of(path): path for path in FILES}


def absolute(node, path):
    """The module that a `from` statement names, with leading dots resolved."""
    if not node.level:
        return node.module or ""
    package = ("jaxtrack", *path.relative_to(ROOT).parts[:-1])
    base = package[: len(package) - node.level + 1]
    return ".".join([*base, *([node.module] if node.module else [])])


def imported(path):
    """All dotted names, modules or things in modules, that a file imports."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        if isinstance(node, ast.ImportFrom):
            module = absolute(node, path)
            yield from (f"{module}.{alias.name}" for alias in node.names)


def own_imports(path):
    """The modules of jaxtrack that a file imports, by their names below it."""
    for name in imported(path):
        if name.split(".")[0] == "jaxtrack":
            parts = name.split(".")[1:]
            while parts and ".".join(parts) not in NAMES:
                parts.pop()
            yield ".".join(parts)


def functions(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node


def public(tree):
    """Public functions, classes and their methods, not what functions hide inside."""
    kinds = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef
    for node in tree.body:
        if isinstance(node, kinds) and not node.name.startswith("_"):
            yield node
            if isinstance(node, ast.ClassDef):
                yield from public(node)


def body_lines(node):
    first = node.body[1] if ast.get_docstring(node) and node.body[1:] else node.body[0]
    return node.end_lineno - first.lineno + 1


def unannotated(node):
    """The arguments without annotation, and 'return' if that is missing."""
    args = node.args
    every = [*args.posonlyargs, *args.args, *args.kwonlyargs, args.vararg, args.kwarg]
    bare = [a.arg for a in every if a and not a.annotation]
    return [a for a in bare if a not in ("self", "cls")] + ["return"] * (
        not node.returns
    )


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_module_stands_in_a_room_and_imports_go_down(path):
    room = name_of(path).split(".")[0]
    above = [name for name in own_imports(path) if not name]
    assert not above, "import rooms, not the package that imports them all"
    for name in own_imports(path):
        assert FLOOR[name.split(".")[0]] <= FLOOR[room], f"{name} is above {room}"


def test_imports_have_no_cycle():
    graph = {name: set(own_imports(path)) - {name} for name, path in NAMES.items()}
    graphlib.TopologicalSorter(graph).prepare()


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_module_and_functions_fit_the_eye(path):
    assert len(path.read_text().splitlines()) <= MAX_FILE_LINES
    long = [node.name for node in functions(path) if body_lines(node) > MAX_BODY_LINES]
    assert not long


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_everything_public_says_what_it_does(path):
    tree = ast.parse(path.read_text())
    assert ast.get_docstring(tree), "the module has no docstring"
    assert not [node.name for node in public(tree) if not ast.get_docstring(node)]


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_everything_public_is_annotated(path):
    bare = {
        node.name: unannotated(node)
        for node in public(ast.parse(path.read_text()))
        if not isinstance(node, ast.ClassDef)
    }
    assert not {name: args for name, args in bare.items() if args}


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_module_has_an_example(path):
    assert ">>> " in path.read_text()


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_no_check_is_silenced(path):
    silencers = ("# noqa", "# type: ignore", "# pyright:", "# ruff:")
    assert not [text for text in silencers if text in path.read_text()]
