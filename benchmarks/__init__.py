"""How fast the library is, beside its peers and a loop in C: one question a file.

`python -m benchmarks.kalman` answers one, `python -m benchmarks` all of them and writes
`results/latest.json`; `--quick` tries everything on tiny sizes.
"""

import os

# Before SciPy's LAPACK is loaded, which makes its threads then: on the one core of a
# benchmark they wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
