"""How fast the library is, beside its peers and a loop in C: one question a file.

`python -m benchmarks.kalman` answers one, `python -m benchmarks` all of them and writes
`results/latest.json`; `--quick` tries everything on tiny sizes.
"""
