"""How one target is filtered: one file, one belief algebra, one `Target`.

>>> from jaxtrack import targets
>>> targets.imm.imm() is targets.imm.imm()  # makers are cached: nothing retraces
True
"""

from jaxtrack.targets import (
    imm,
    likely_modes,
    mixture,
    particles,
    rao_blackwell,
    single,
)

__all__ = ["imm", "likely_modes", "mixture", "particles", "rao_blackwell", "single"]
