"""Slopes by central differences, entry by entry, of a function compiled for a batch.

    moved, scale = walks(params)             # every entry ahead, then every entry back
    found = differences(values_of(moved))    # per `scale` of each entry
    expected = flat(slope) * scale

One call of one program tells all slopes, which costs no more than to compile it once.
"""

import jax
import numpy as np

STEP = 1e-5


def flat(tree):
    """All entries of all leaves in a row."""
    leaves = [np.ravel(leaf) for leaf in jax.tree.leaves(tree)]
    return np.concatenate(leaves).astype(float)


def rows_of(tree, rows):
    """The tree that `flat` was taken of, with rows [B, E] of entries for each leaf."""
    leaves, structure = jax.tree.flatten(tree)
    ends = np.cumsum([np.size(leaf) for leaf in leaves])[:-1]
    parts = zip(np.split(rows, ends, axis=1), leaves, strict=True)
    return jax.tree.unflatten(
        structure, [part.reshape(len(rows), *np.shape(leaf)) for part, leaf in parts]
    )


def walks(tree, floor=1e-2, step=STEP):
    """Moves each of the E entries by `step` times its scale, ahead and back.

    Args:
        tree: Arrays of floats.
        floor: Entries are taken for no smaller than this times the largest of their
            leaf, so that a zero among tens moves by something that matters.
        step: Of the differences, in scales.

    Returns:
        The tree with a leading axis of 2 E, and the scales [E].
    """
    sizes = [np.abs(np.asarray(leaf)) for leaf in jax.tree.leaves(tree)]
    scale = flat([np.maximum(x, floor * (x.max(initial=0.0) or 1.0)) for x in sizes])
    ahead = np.diag(step * scale)
    return rows_of(tree, flat(tree) + np.concatenate([ahead, -ahead])), scale


def differences(values, step=STEP):
    """Slopes [E, ...] per scale, of the values [2 E, ...] at the places of `walks`."""
    ahead, back = np.split(np.asarray(values), 2)
    return (ahead - back) / (2 * step)


def names(tree):
    """What each entry is called, [E], for messages."""
    told = []
    for path, leaf in jax.tree_util.tree_leaves_with_path(tree):
        told += [f"{jax.tree_util.keystr(path)} {i}" for i in np.ndindex(leaf.shape)]
    return told


def assert_right(tree, slope, found, scale, rtol, atol):
    """Holds a slope against differences and names the entries that are wrong."""
    assert_near(tree, flat(slope) * scale, found, rtol, atol)


def assert_near(tree, expected, found, rtol, atol):
    """Holds slopes [E] per scale against differences, and names what is wrong."""
    wrong = ~np.isclose(expected, found, rtol=rtol, atol=atol)
    report = [
        f"{name}: {a} by gradient, {b} by differences"
        for name, a, b, bad in zip(names(tree), expected, found, wrong, strict=True)
        if bad
    ]
    assert not report, "\n".join(report)
