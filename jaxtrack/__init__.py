"""Multi-target tracking in JAX: pure functions, jitted, vmapped and differentiable."""

__version__ = "0.1.0"
