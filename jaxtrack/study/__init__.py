"""The paperwork of a Monte Carlo study, which `engine.monte_carlo` computes.

`sweep` says what is to be computed, `devices` shares it out, `scores` says how well a
run went, `parts` keeps on disk what is done, `table` joins the parts into a dataset and
sums it up.

    >>> from jaxtrack.study import sweep
    >>> [sweep.label(point) for point in sweep.points({"clutter_rate": [20, 60]})]
    ['clutter_rate=20', 'clutter_rate=60']
"""
