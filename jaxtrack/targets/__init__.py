"""How one target is filtered: one file, one belief algebra, one `Target`.

>>> from jaxtrack import targets
>>> targets.imm.imm() is targets.imm.imm()  # makers are cached: nothing retraces
True
"""

from jaxtrack.targets import imm, mixture, single

__all__ = ["imm", "mixture", "single"]
