"""How many targets there are: one file, one algorithm, one `Tracker`.

>>> from jaxtrack import targets, trackers
>>> sorted(trackers.cbmember.cbmember(targets.single.single())._fields)
['init', 'step']
"""

from jaxtrack.trackers import bernoulli, cbmember

__all__ = ["bernoulli", "cbmember"]
