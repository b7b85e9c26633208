"""What values a parameter may have, said where the parameter is declared.

A field of a model or of `Params` is annotated with one of these in place of `Array`;
`jaxtrack.learn` reads it there. A plain `Array` may be any real number. The annotation
changes nothing else, and tuples of one's own may use them.

An entry that stands on the boundary of what is allowed stays there: a noise of 0, a
probability of 0 or 1, a transition that cannot happen. So a structure given at the
start is kept.

    >>> from typing import NamedTuple, get_type_hints
    >>> from jaxtrack.constraints import Positive, of
    >>> class Drag(NamedTuple):
    ...     coefficient: Positive
    >>> of(get_type_hints(Drag, include_extras=True)["coefficient"]).kind
    'positive'
"""

import typing
from typing import Annotated, Any, Literal, NamedTuple

from jaxtrack.types import Array

Kind = Literal[
    "real", "positive", "probability", "below", "simplex", "jumps", "covariance"
]


class Constraint(NamedTuple):
    """What values an array may have.

    Attributes:
        kind: Which values.
        other: The field of the same tuple that they refer to, "" if none.
        fixed: Whether it is learned only if it is chosen itself, by name.
    """

    kind: Kind
    other: str = ""
    fixed: bool = False


REAL = Constraint("real")

Positive = Annotated[Array, Constraint("positive")]
"""Each entry is more than 0."""

Probability = Annotated[Array, Constraint("probability")]
"""Each entry is between 0 and 1."""

Simplex = Annotated[Array, Constraint("simplex")]
"""Entries are not negative and sum to one over the last axis."""

Jumps = Annotated[Array, Constraint("jumps")]
"""Square; rows are a simplex off the diagonal, which is not looked at."""

Covariance = Annotated[Array, Constraint("covariance")]
"""Symmetric and positive definite in the last two axes, but for rows of zeros."""

Fixed = Annotated[Array, Constraint("real", fixed=True)]
"""Any real number that is known: a place, a bound, a limit."""


def below(other: str) -> Constraint:
    """Returns the constraint of probabilities below those of another field.

    To be used as `Annotated[Array, below("principal_prob")]`.
    """
    return Constraint("below", other)


def spread_by(other: str) -> Constraint:
    """Returns that of real numbers whose scale the covariance in another field tells.

    A mean next to its covariance: a step of 1 is a standard deviation.
    """
    return Constraint("real", other)


def of(annotation: Any) -> Constraint | None:
    """Returns the constraint in an annotation, also within a union, None without."""
    for part in getattr(annotation, "__metadata__", ()):
        if isinstance(part, Constraint):
            return part
    found = [of(part) for part in typing.get_args(annotation)]
    return next((constraint for constraint in found if constraint), None)
