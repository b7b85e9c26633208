"""Recorded detections in, tracks, scores and a picture out.

    table = data.files.read_detections("radar.csv")
    result = tracking.track(table)                  # settings guessed from the data
    scores = scoring.score(result, table, "ship")   # against a column of the file
    figure = picture.chart(result, table)

>>> from jaxtrack.recorded import settings
>>> settings.Settings().scans.period is None
True
"""

from jaxtrack.recorded import (
    fitted,
    guess,
    picture,
    reading,
    scoring,
    settings,
    tracking,
)

__all__ = ["fitted", "guess", "picture", "reading", "scoring", "settings", "tracking"]
