"""Several sensors over many scans: labels stay, and what finds no room is told."""

import functools

import jax
import numpy as np
import pytest
from cases import two_sensors as cases
from cases.lines import scans_of

from jaxtrack import engine
from jaxtrack.models import birth
from jaxtrack.trackers import several_cbmember, several_phd
from jaxtrack.types import Scans

SCANS, PLACES = 6, np.array([-6.0, 0.0, 6.0])
SIZES = {
    "phd": (several_phd.several_phd, {"max_components": 2}),
    "cphd": (several_phd.several_cphd, {"max_components": 2, "max_targets": 4}),
    "cbmember": (several_cbmember.several_cbmember, {"max_tracks": 2}),
}


@pytest.mark.parametrize("form", cases.FORMS)
@pytest.mark.parametrize("name", SIZES)
def test_two_targets_keep_their_labels_in_two_slots(name, form):
    """Both at rest, seen by both sensors; between them nobody is ever detected."""
    maker, sizes = SIZES[name]
    tracker = maker(cases.TARGET, form=form, prune_threshold=1e-4, **sizes)
    rng = np.random.default_rng(1)
    some = cases.scene(rng)._replace(
        detect=(0.95, 0.9), std=(0.5, 0.7), rate=(0.2, 0.1)
    )
    births = birth.PoissonBirth(
        rate=np.array([0.05, 0.02, 0.04]),
        mean=np.stack([PLACES, np.zeros(3)], 1),
        cov=np.tile(2.0 * np.eye(2), (3, 1, 1)),
        mode_prob=np.ones((3, 1)),
    )
    target = cases.params_of(some).target
    still = target._replace(
        motion=target.motion._replace(noise_density=np.full(1, 0.01))
    )
    params = cases.params_of(some)._replace(target=still, birth=births)
    each = []
    for std in some.std:
        seen = PLACES[[0, 2]] + std * rng.normal(size=(SCANS, 2))
        each.append(scans_of(list(seen), 3, 1.0))
    scans = Scans(tuple(each), np.ones((SCANS, 2), bool))
    told = jax.jit(functools.partial(engine.run, tracker))(
        params, scans, jax.random.key(0)
    )
    assert told.exists[1:].sum(1).tolist() == [2] * (SCANS - 1)
    order = np.argsort(told.mean[..., 0], axis=1)
    labels = np.take_along_axis(np.array(told.label), order, axis=1)
    assert (labels[1:] == labels[1]).all()
    assert labels[1, 0] != labels[1, 1]
    # Between the two somebody may be born in each scan, and there is no slot.
    assert (told.dropped > 1e-4).all()
