"""What README.md and docs/ show is run, and what they tell to type is there."""

import functools
import pathlib
import re
import shlex

import jax
import jax.numpy as jnp
import pytest
import typer

from jaxtrack import cli
from jaxtrack.cli.compare import parse_settings
from jaxtrack.recorded import settings
from jaxtrack.study import sweep

ROOT = pathlib.Path(__file__).parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
# Lines set apart, and words in backticks, up to where the shell takes over.
TYPED = re.compile(
    r"^(?: {4}|\$ )((?:jaxtrack|make|python -m) [^>\n]+)"
    r"|`((?:jaxtrack|make|python -m) [^>`\n]+)`",
    re.MULTILINE,
)
LINK = re.compile(r"\]\((?!https?:)([^)#]+)")


def blocks(page):
    """The Python of a page, each block at its own line for the traceback."""
    text = page.read_text("utf-8")
    for found in BLOCK.finditer(text):
        yield "\n" * (text[: found.start()].count("\n") + 1) + found[1]


def commands():
    """What the pages tell to type, each once, as words."""
    for page in PAGES:
        text = page.read_text("utf-8").replace("\\\n", " ")
        for apart, inline in TYPED.findall(text):
            yield tuple(shlex.split(apart or inline, comments=True))


SHOWN = [page for page in PAGES if any(blocks(page))]
LINES = list(dict.fromkeys(commands()))


@functools.cache
def made(name, point):
    """A scenario, made once for the same settings."""
    return sweep.make(name, dict(point))


def traced(grad):
    """A `jax.grad` that traces the gradient, with zeros for its values.

    Compiling that of a whole tracker takes twice as long as all other pages together;
    what it is worth is held by the contract of the trackers.
    """

    def traced_grad(function):
        def gradient(*arguments):
            shapes = jax.eval_shape(grad(function), *arguments)
            return jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)

        return gradient

    return traced_grad


def parse(words):
    """The options of a command of ours, as it would get them."""
    command = typer.main.get_command(cli.app).commands[words[1]]
    # A name alone is what a sentence speaks of, and may lack arguments.
    alone = len(words) == 2
    return command.make_context(words[1], words[2:], resilient_parsing=alone).params


def check_study(name, given):
    """Refuses a scenario, a tracker or a setting that there is not."""
    swept = parse_settings(given["settings"] or [])
    point = tuple((key, values[0]) for key, values in swept.items())
    scenario = made(given["scenario"], point)
    trackers = given["trackers"]
    names = trackers.split(",") if trackers else list(scenario.trackers)
    sweep.check_trackers(scenario, names)
    if name == "follow":
        cli.follow.check(scenario, names, given["runs"])


@pytest.mark.parametrize("page", SHOWN, ids=lambda page: page.name)
def test_python_that_a_page_shows_runs(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(jax, "grad", traced(jax.grad))
    names = {"__name__": page.stem}
    for block in blocks(page):
        exec(compile(block, str(page), "exec"), names)


@pytest.mark.parametrize("words", LINES, ids=lambda words: " ".join(words)[:50])
def test_what_a_page_tells_to_type_is_there(words):
    if words[0] == "make":
        assert re.search(rf"^{words[1]}:", (ROOT / "Makefile").read_text(), re.M)
    elif words[0] == "python":
        module = ROOT.joinpath(*words[2].split("."))
        assert module.with_suffix(".py").exists() or (module / "__main__.py").exists()
    else:
        given = parse(list(words))
        if given.get("scenario"):
            check_study(words[1], given)
        elif given.get("tracker"):
            settings.check_name(given["tracker"])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_of_a_page_lead_somewhere(page):
    links = LINK.findall(page.read_text("utf-8"))
    assert not [link for link in links if not (page.parent / link).exists()]


def test_pages_have_something_to_try():
    assert {page.name for page in SHOWN} >= {"README.md", "data.md"}
    typed = {words[:2] for words in LINES}
    assert {("jaxtrack", "compare"), ("jaxtrack", "track"), ("make", "demo")} <= typed
