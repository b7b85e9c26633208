r"""Detections, ground truth and tracks in the text form of MOTChallenge.

    boxes = read_boxes("det/det.txt")
    scans = scans_from_boxes(boxes, frame_rate=30.0)             # centres, in pixels
    ids, truth = truth_from_boxes(read_boxes("gt/gt.txt"), 30.0)
    write_boxes("result.txt", boxes_from_estimates(estimates, (0, 2), size=(40, 90)))

A line is frame, id, left, top, width, height, confidence, x, y, z: the box in pixels,
the place in the world in metres, -1 for what is not known; lines may end after the
confidence. Ground truth may have class and visibility in place of x, y, z. Frames count
from 1, and frame f is at (f - 1) / frame_rate seconds. (https://motchallenge.net)

Example:
    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "det.txt"
    >>> _ = path.write_text("1,-1,10,20,4,6,1,-1,-1,-1\n3,-1,11,20,4,6,1,-1,-1,-1\n")
    >>> scans = scans_from_boxes(read_boxes(path), frame_rate=25.0)
    >>> print(scans.time, scans.scan.detections[:, 0].tolist())
    [0.   0.04 0.08] [[12.0, 23.0], [0.0, 0.0], [13.0, 23.0]]
"""

import os
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from jaxtrack.data.cells import read_cells, read_numbers, refuse, write_cells
from jaxtrack.data.errors import DataError, import_pandas
from jaxtrack.data.rows import truth_from_rows
from jaxtrack.data.scans import Scans, fill_scans
from jaxtrack.data.tables import reported
from jaxtrack.scenarios.world import Truth
from jaxtrack.types import PyTree

UNKNOWN = -1
NAMES = (
    *("frame", "id", "bb_left", "bb_top", "bb_width", "bb_height"),
    *("conf", "x", "y", "z"),
)
TRUTH_NAMES = (*NAMES[:7], "class", "visibility")
LAYOUTS = {7: NAMES[:7], 9: TRUTH_NAMES, 10: NAMES}

What = Literal["centre", "box", "world"]


class Boxes(NamedTuple):
    """The n lines of a file; -1 stands for what is not known.

    Attributes:
        frame: Counted from 1, [n].
        id: Whose it is, [n]; detections have -1.
        box: left, top, width, height in pixels, [n, 4].
        confidence: [n]; of ground truth 0 where a box is not to be scored.
        world: x, y, z in metres, [n, 3].
        kind: Class of ground truth (1 is a pedestrian), [n].
        visibility: Share of ground truth that is not hidden, [n].
    """

    frame: np.ndarray
    id: np.ndarray
    box: np.ndarray
    confidence: np.ndarray
    world: np.ndarray
    kind: np.ndarray
    visibility: np.ndarray


def read_boxes(path: str | os.PathLike[str]) -> Boxes:
    """Reads a file, which may be empty.

    Raises:
        DataError: If it cannot be read, a line has other columns than 7, 9 or 10, or a
            cell is wrong.
    """
    cells = read_cells(path, max_columns=len(NAMES))
    size = cells.shape[1]
    if not len(cells):
        cells, size = cells.reindex(columns=range(10)), 10
    if size == 1:
        raise DataError(f"{path} has a single column; separate columns by commas.")
    if size not in LAYOUTS:
        raise DataError(
            f"{path} has {size} columns; give 7 ({', '.join(NAMES[:7])}), 9 (class and "
            "visibility too) or 10 (x, y and z)."
        )
    cells.columns = list(LAYOUTS[size])
    values = {name: read_numbers(path, cells[name].astype(str)) for name in cells}
    for name in {"frame", "id", "class"} & set(cells):
        why = "is not a whole number; correct it"
        refuse(path, cells[name], values[name] % 1.0 != 0.0, why)
    refuse(path, cells["frame"], values["frame"] < 1, "is below 1, the first frame")

    unknown = np.full(len(cells), float(UNKNOWN))
    column = {name: values.get(name, unknown) for name in (*NAMES, *TRUTH_NAMES)}
    return Boxes(
        frame=column["frame"].astype(int),
        id=column["id"].astype(int),
        box=np.stack([column[name] for name in NAMES[2:6]], axis=1),
        confidence=column["conf"],
        world=np.stack([column[name] for name in NAMES[7:]], axis=1),
        kind=column["class"].astype(int),
        visibility=column["visibility"],
    )


def write_boxes(path: str | os.PathLike[str], boxes: Boxes) -> None:
    """Writes a file that `read_boxes` reads back as it was.

    Lines have class and visibility if one of these is known, else x, y and z.

    Args:
        path: The file; what it held is lost.
        boxes: What to write.

    Raises:
        DataError: If world and class are both known, or the file cannot be written.
    """
    pandas = import_pandas()
    kinds = (boxes.kind != UNKNOWN) | (boxes.visibility != UNKNOWN)
    if kinds.any() and (boxes.world != UNKNOWN).any():
        raise DataError(
            "A line has room for x, y, z or for class and visibility; set world, or "
            "kind and visibility, to -1."
        )
    last = [boxes.kind, boxes.visibility] if kinds.any() else list(boxes.world.T)
    columns = [boxes.frame, boxes.id, *boxes.box.T, boxes.confidence, *last]
    # Whole numbers without a point, as other programs write an unknown -1.
    tidy = [x.astype(int) if (x == np.rint(x)).all() else x for x in columns]
    write_cells(path, pandas.DataFrame(dict(enumerate(tidy))), header=False)


def measured(boxes: Boxes, what: What = "centre") -> np.ndarray:
    """Takes what was measured.

    Args:
        boxes: n lines.
        what: The box's "centre" in pixels [n, 2]; the "box" as centre, width and
            height [n, 4]; or the place in the "world", x and y in metres [n, 2], with
            z [n, 3] if the lines know it.

    Raises:
        DataError: If a place in the world is not known, or z is known of some lines
            and not of others: then choose the lines, or set all z to -1.
    """
    if what == "world":
        lost = (boxes.world[:, :2] == UNKNOWN).all(axis=1)
        if lost.any():
            k = int(np.argmax(lost))
            raise DataError(
                f"Line {k}, counted from 0, in frame {boxes.frame[k]} has no place in "
                'the world (x and y are -1); use "centre" or "box".'
            )
        flat = boxes.world[:, 2] == UNKNOWN
        if flat.any() and not flat.all():
            k = int(np.argmax(flat))
            raise DataError(
                f"Line {k}, counted from 0, in frame {boxes.frame[k]} has no z (it is "
                "-1), but others have; leave such lines out, or set every z to -1."
            )
        return boxes.world[:, :2] if flat.all() else boxes.world
    if what not in ("centre", "box"):
        raise ValueError(f'what is {what!r}; give "centre", "box" or "world".')
    centre = boxes.box[:, :2] + boxes.box[:, 2:] / 2.0
    return centre if what == "centre" else np.hstack([centre, boxes.box[:, 2:]])


def scans_from_boxes(
    boxes: Boxes,
    frame_rate: float,
    what: What = "centre",
    num_frames: int | None = None,
    max_detections: int | None = None,
) -> Scans:
    """Makes a scan of each frame; one without a line is an empty scan.

    Args:
        boxes: From `read_boxes`.
        frame_rate: Frames a second.
        what: See `measured`.
        num_frames: How many there are (T); by default up to the last with a line.
        max_detections: See `fill_scans`.

    Returns:
        The scans, whose `row` counts lines from 0.

    Raises:
        ValueError: If the settings make no scans.
        DataError: If a place is not known, or a frame is after the last.
    """
    time = _frame_times(boxes, frame_rate, num_frames)
    scan_of = boxes.frame - 1
    return fill_scans(
        scan_of, measured(boxes, what), time, 1.0 / frame_rate, max_detections
    )


def truth_from_boxes(
    boxes: Boxes,
    frame_rate: float,
    what: What = "centre",
    num_frames: int | None = None,
) -> tuple[np.ndarray, Truth]:
    """Makes truth of lines with identities.

    Leave lines out first that do not count, such as those of confidence 0.

    Args:
        boxes: From `read_boxes`, of ground truth or of tracks.
        frame_rate: Frames a second.
        what: See `measured`; it becomes the state (D).
        num_frames: How many there are (T); by default up to the last with a line.

    Returns:
        The N identities in sorted order, and the truth.

    Raises:
        ValueError: If the settings make no frames.
        DataError: If a line has no identity, an identity has two in one frame, a place
            is not known, or a frame is after the last.
    """
    nobody = boxes.id == UNKNOWN
    if nobody.any():
        k = int(np.argmax(nobody))
        raise DataError(
            f"Line {k}, counted from 0, in frame {boxes.frame[k]} has the id -1; read "
            "ground truth, or detections with scans_from_boxes."
        )
    time = _frame_times(boxes, frame_rate, num_frames)
    return truth_from_rows(time[boxes.frame - 1], boxes.id, measured(boxes, what), time)


def boxes_from_estimates(
    estimates: PyTree,
    position_index: Sequence[int],
    size: tuple[float, float] | None = None,
) -> Boxes:
    """Makes lines of the reported targets, frame by frame, in the order of labels.

    Args:
        estimates: Estimates of a tracker for T frames: mean [T, N, D], label [T, N],
            exists [T, N], existence_prob [T, N], which becomes the confidence.
        position_index: Which components of the state are the place: two, or three of
            a place in the world.
        size: Width and height of every box in pixels about the centre at the place;
            None if the place is in the world, in metres, and there are no boxes.

    Returns:
        The lines; ids are labels.

    Raises:
        ValueError: If an argument has another shape.
    """
    _check_place(position_index, size)
    scan, slot, label = reported(estimates)
    place = np.asarray(estimates.mean, float)[scan, slot][:, list(position_index)]
    box = np.full((len(scan), 4), float(UNKNOWN))
    world = np.full((len(scan), 3), float(UNKNOWN))
    if size is None:
        world[:, : place.shape[1]] = place
    else:
        box[:, 2:] = size
        box[:, :2] = place - box[:, 2:] / 2.0
    return Boxes(
        frame=scan + 1,
        id=label.astype(int),
        box=box,
        confidence=np.asarray(estimates.existence_prob, float)[scan, slot],
        world=world,
        kind=np.full(len(scan), UNKNOWN),
        visibility=np.full(len(scan), float(UNKNOWN)),
    )


def _check_place(position_index: Sequence[int], size: Any) -> None:
    """Refuses what makes no boxes or places."""
    if size is not None and not (np.shape(size) == (2,) and np.all(np.array(size) > 0)):
        raise ValueError(
            f"size is {size}; give (width, height) in pixels above 0, or None for a "
            "place in the world."
        )
    most = 2 if size is not None else 3
    if not (np.ndim(position_index) == 1 and 2 <= len(position_index) <= most):
        told = "2" if most == 2 else "2 or 3"
        raise ValueError(f"position_index is {position_index}; give {told} components.")


def _frame_times(boxes: Boxes, frame_rate: float, num_frames: int | None) -> np.ndarray:
    """Returns the times of all frames, [T]."""
    if not 0.0 < frame_rate < np.inf:
        raise ValueError(f"frame_rate is {frame_rate}; give frames a second above 0.")
    last = int(boxes.frame.max(initial=0))
    if num_frames is not None and num_frames < last:
        raise DataError(
            f"num_frames is {num_frames}, but a line is of frame {last}; give at least "
            "that."
        )
    return np.arange(last if num_frames is None else num_frames) / frame_rate
