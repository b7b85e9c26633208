"""Tests of `learn.bar`."""

import io
import sys

import pytest
from rich.console import Console

from jaxtrack import learn


def drawn(**settings):
    """What is written while two of three steps are done."""
    out = io.StringIO()
    console = Console(file=out, width=80, **settings)
    with learn.progress_bar(console) as progress:
        progress(1, 3, 12.5)
        progress(2, 3, 11.25)
    return out.getvalue()


def test_the_bar_tells_steps_and_loss():
    text = drawn(force_terminal=True)
    assert "2/3" in text
    assert "loss 11.25" in text


def test_without_a_terminal_nothing_is_drawn():
    assert drawn().strip() == ""


def test_without_rich_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "rich.progress", None)
    with (
        pytest.raises(RuntimeError, match='pip install "jaxtrack\\[cli\\]"'),
        learn.progress_bar(),
    ):
        pass
